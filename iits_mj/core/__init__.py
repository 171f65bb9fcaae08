"""Basis of all packages: messages, errors, options, checks, results, units and tables."""
