"""The truck's MJCF, built from `iits_mj.parameters`, which hold every number once."""
