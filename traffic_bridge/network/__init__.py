"""Map network: from a RoadMap to SUMO's net, and where its lanes lie on map and route."""
