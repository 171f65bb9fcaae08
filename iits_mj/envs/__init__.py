"""Gymnasium environments of the truck, registered when this module or `iits_mj` is imported.

    import gymnasium

    environment = gymnasium.make("iits_mj:iits_mj/LaneKeep-v0")

Gymnasium imports the module before the colon, in every worker process as well. After
`import iits_mj` the id alone is enough: `gymnasium.make("iits_mj/LaneKeep-v0")`.
"""

from typing import Any

from gymnasium.envs import registration


def _driving(task: str, steps: int, threshold: float) -> dict[str, Any]:
    """Returns the registration of a task of the suite, alone and vectorized."""
    return {
        "entry_point": "iits_mj.envs.driving:DrivingEnv",
        "vector_entry_point": "iits_mj.envs.vector:DrivingVectorEnv",
        "kwargs": {"task": task},
        "max_episode_steps": steps,
        "reward_threshold": threshold,
    }


def _other(entry_point: str, steps: int, threshold: float) -> dict[str, Any]:
    """Returns the registration of another environment."""
    return {
        "entry_point": f"iits_mj.envs.{entry_point}",
        "max_episode_steps": steps,
        "reward_threshold": threshold,
    }


# Ids and their registrations. An episode's last step is the time limit of a default environment. A
# threshold is 95 % of the way from the random to the scripted driver of docs/benchmark.md.
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "iits_mj/Cruise-v0": _driving("cruise", 120, 89.0),
    "iits_mj/Stop-v0": _driving("stop", 80, 73.0),
    "iits_mj/HillStart-v0": _driving("hill_start", 200, 103.0),
    "iits_mj/LaneKeep-v0": _driving("lane_keep", 600, 569.0),
    "iits_mj/LaneChange-v0": _driving("lane_change", 300, 247.0),
    "iits_mj/TightTurn-v0": _driving("tight_turn", 300, 285.0),
    "iits_mj/Dock-v0": _driving("dock", 120, 91.0),
    "iits_mj/CutIn-v0": _driving("cut_in", 200, 122.0),
    "iits_mj/EmergencyStop-v0": _driving("emergency_stop", 200, 154.0),
    "iits_mj/Highway-v0": _other("highway:HighwayEnv", 120, -6.9),
    "iits_mj/HighwayFast-v0": {
        **_other("highway:HighwayFastEnv", 120, -2.7),
        "vector_entry_point": "iits_mj.envs.highway_vector:HighwayFastVectorEnv",
    },
    "iits_mj/SpeedPlanning-v0": _other("speed_planning:SpeedPlanningEnv", 120, -3.42),
    "iits_mj/Hoel2020-v0": _other("hoel2020:Hoel2020Env", 100, 70.0),
}

# Trucks of which a hard environment draws one for each episode; the agent does not see which.
_FAMILY = {"truck": ("tractor_semitrailer_6x4", "tractor_semitrailer_6x2", "vecto_40t")}
# Arguments of the easier and harder forms of an environment: `iits_mj/CruiseHard-v0`. A published
# scenario has none.
LEVELS: dict[str, dict[str, dict[str, Any]]] = {
    name: {"Easy": {"density": "sparse"}, "Hard": {"density": "dense", "traffic_speed": 12.5}}
    if "Highway" in name
    else {"Easy": {"payload": 0.0}, "Hard": _FAMILY}
    for name in ENVIRONMENTS
}
LEVELS["iits_mj/Hoel2020-v0"] = {}


def level_id(name: str, level: str) -> str:
    """Returns the id of a level of an environment: `iits_mj/CruiseHard-v0`."""
    return name.replace("-v", f"{level}-v")


def registrations() -> dict[str, dict[str, Any]]:
    """Returns all ids with their registrations: the environments, and their levels.

    The thresholds are those of the environments themselves, so the levels have none.
    """
    found = dict(ENVIRONMENTS)
    for name, settings in ENVIRONMENTS.items():
        for level, arguments in LEVELS[name].items():
            found[level_id(name, level)] = {
                **settings,
                "kwargs": {**settings.get("kwargs", {}), **arguments},
                "reward_threshold": None,
            }
    return found


def register() -> None:
    """Registers the environments that Gymnasium does not have yet."""
    for name, settings in registrations().items():
        if name not in registration.registry:
            registration.register(name, **settings)


register()
