"""Periods of the clock that truck, controller, planner and traffic share [s]."""

# Time step of the physics; drives may choose another one that divides CONTROL_PERIOD.
TIMESTEP = 0.002
# The tracking controller commands the truck.
CONTROL_PERIOD = 0.02
# The traffic advances, the scene is observed, and the planner plans.
CYCLE_PERIOD = 0.1
