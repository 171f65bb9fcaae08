"""Gymnasium environments of the truck, registered when this module or `iits_mj` is imported.

    import gymnasium

    environment = gymnasium.make("iits_mj:iits_mj/LaneKeep-v0")

Gymnasium imports the module before the colon, in every worker process as well. After
`import iits_mj.envs` the id alone is enough: `gymnasium.make("iits_mj/LaneKeep-v0")`.
"""

from typing import Any

from gymnasium.envs import registration


def _driving(task: str) -> dict[str, Any]:
    """Returns the registration of a task of the suite, alone and vectorized."""
    return {
        "entry_point": "iits_mj.envs.driving:DrivingEnv",
        "vector_entry_point": "iits_mj.envs.vector:DrivingVectorEnv",
        "kwargs": {"task": task},
    }


# Ids and their registrations.
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "iits_mj/Cruise-v0": _driving("cruise"),
    "iits_mj/Stop-v0": _driving("stop"),
    "iits_mj/HillStart-v0": _driving("hill_start"),
    "iits_mj/LaneKeep-v0": _driving("lane_keep"),
    "iits_mj/LaneChange-v0": _driving("lane_change"),
    "iits_mj/TightTurn-v0": _driving("tight_turn"),
    "iits_mj/Dock-v0": _driving("dock"),
    "iits_mj/Highway-v0": {"entry_point": "iits_mj.envs.highway:HighwayEnv"},
    "iits_mj/HighwayFast-v0": {
        "entry_point": "iits_mj.envs.highway:HighwayFastEnv",
        "vector_entry_point": "iits_mj.envs.highway_vector:HighwayFastVectorEnv",
    },
    "iits_mj/SpeedPlanning-v0": {"entry_point": "iits_mj.envs.speed_planning:SpeedPlanningEnv"},
}


def register() -> None:
    """Registers the environments that Gymnasium does not have yet."""
    for name, settings in ENVIRONMENTS.items():
        if name not in registration.registry:
            registration.register(name, **settings)


register()
