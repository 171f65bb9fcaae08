"""Sweeps of a scenario: drives at many values of its parameters, and the map of their outcomes."""
