"""Gymnasium environments of the truck, registered when this module or `iits_mj` is imported.

    import gymnasium

    environment = gymnasium.make("iits_mj:iits_mj/LaneKeep-v0")

Gymnasium imports the module before the colon, in every worker process as well. After
`import iits_mj.envs` the id alone is enough: `gymnasium.make("iits_mj/LaneKeep-v0")`.
"""

from gymnasium.envs import registration

# Id to the class and, for `gymnasium.make_vec`, the function that makes many at once.
ENVIRONMENTS: dict[str, tuple[str, str | None]] = {
    "iits_mj/Cruise-v0": ("iits_mj.envs.driving:CruiseEnv", "iits_mj.envs.vector:cruise"),
    "iits_mj/Stop-v0": ("iits_mj.envs.driving:StopEnv", "iits_mj.envs.vector:stop"),
    "iits_mj/HillStart-v0": ("iits_mj.envs.driving:HillStartEnv", "iits_mj.envs.vector:hill_start"),
    "iits_mj/LaneKeep-v0": ("iits_mj.envs.driving:LaneKeepEnv", "iits_mj.envs.vector:lane_keep"),
    "iits_mj/LaneChange-v0": (
        "iits_mj.envs.driving:LaneChangeEnv",
        "iits_mj.envs.vector:lane_change",
    ),
    "iits_mj/TightTurn-v0": ("iits_mj.envs.driving:TightTurnEnv", "iits_mj.envs.vector:tight_turn"),
    "iits_mj/Dock-v0": ("iits_mj.envs.driving:DockEnv", "iits_mj.envs.vector:dock"),
    "iits_mj/Highway-v0": ("iits_mj.envs.highway:HighwayEnv", None),
    "iits_mj/HighwayFast-v0": ("iits_mj.envs.highway:HighwayFastEnv", None),
    "iits_mj/SpeedPlanning-v0": ("iits_mj.envs.speed_planning:SpeedPlanningEnv", None),
}


def register() -> None:
    """Registers the environments that Gymnasium does not have yet."""
    for name, (entry_point, vector_entry_point) in ENVIRONMENTS.items():
        if name not in registration.registry:
            registration.register(
                name, entry_point=entry_point, vector_entry_point=vector_entry_point
            )


register()
