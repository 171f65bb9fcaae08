"""The modes of the traffic: PureSim, InterSim, RepSim, ReSim and MixedSim, and their parts."""
