"""The fast world: a point-mass truck among IDM and MOBIL vehicles, in numpy."""
