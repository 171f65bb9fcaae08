"""Traffic controller: lights, limits, closures and what else a script does to the traffic."""
