"""Decision, planning and tracking: depends on messages and roads, not on MuJoCo or SUMO."""
