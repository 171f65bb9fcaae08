"""The modes of the traffic: PureSim, InterSim, RepSim, ReSim, MixedSim, in parallel or not."""
