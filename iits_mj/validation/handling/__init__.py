"""Handling: steering, roll-over, swept path and braking in bends, by named procedures."""
