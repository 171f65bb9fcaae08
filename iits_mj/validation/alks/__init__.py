"""Automated lane keeping against a careful driver of the truck, by UN R157 and R130."""
