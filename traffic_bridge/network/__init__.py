"""The roads of a map as SUMO sees them: nets, lanes, graphs and positions."""
