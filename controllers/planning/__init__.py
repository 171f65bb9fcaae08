"""Trajectory planning: leaders, limits, stops, lane changes and a speed plan."""
