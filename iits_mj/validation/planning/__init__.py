"""Planning, tracking and predictive cruise control, against their limits and bounds."""
