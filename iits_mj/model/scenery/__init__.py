"""Scenery: the road's surface, structures, landscape and trees, for pictures only."""
