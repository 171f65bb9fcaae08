"""Longitudinal dynamics: acceleration, climbing, braking, descents, fuel and energy."""
