"""Traffic: against its model's closed form and against recorded trajectories."""
