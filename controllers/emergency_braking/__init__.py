"""Advanced emergency braking: warns of a collision ahead and brakes, apart from the planner."""

from controllers.emergency_braking.braking import EmergencyBraking, EmergencyReport, EmergencyState

__all__ = ["EmergencyBraking", "EmergencyReport", "EmergencyState"]
