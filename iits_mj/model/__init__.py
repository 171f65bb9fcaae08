"""The truck's MJCF: built from `iits_mj.parameters`, the one place of every number."""
