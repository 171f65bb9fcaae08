"""What every package speaks: messages, errors, options, checks, results, units and tables."""
