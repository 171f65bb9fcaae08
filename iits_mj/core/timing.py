"""Plants of the truck, and periods of the clock that all parts of a simulation share [s]."""

# Models of the truck's motion: MuJoCo's bodies, planar motion with and without roll, and planar
# motion without slip.
DYNAMIC_PLANTS = ("full", "yaw-roll", "yaw-sideslip")
PLANTS = (*DYNAMIC_PLANTS, "kinematic")
# Time step of the physics; a drive may use another one that divides CONTROL_PERIOD.
TIMESTEP = 0.002
# Period at which the tracking controller commands the truck.
CONTROL_PERIOD = 0.02
# Period at which the traffic advances, the scene is observed, and the planner plans.
CYCLE_PERIOD = 0.1
