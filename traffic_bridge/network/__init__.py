"""The roads of a map in SUMO: nets, lanes, graphs and positions."""
