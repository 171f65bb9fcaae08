"""PureSim, InterSim, ReSim, RepSim and their mix; many of them at once."""
