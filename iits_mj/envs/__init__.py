"""Gymnasium environments: `gymnasium.make("iits_mj/Highway-v0")` needs no import of ours.

They are registered when Gymnasium is imported (`startup`), or when this module is.

| id                      | decides on          | class                              |
|-------------------------|---------------------|------------------------------------|
| `iits_mj/Cruise-v0`     | pedal and brakes    | `iits_mj.envs.driving.CruiseEnv`   |
| `iits_mj/LaneKeep-v0`   | and steering wheel  | `iits_mj.envs.driving.LaneKeepEnv` |
| `iits_mj/Highway-v0`    | lane changes        | `iits_mj.envs.highway.HighwayEnv`  |
"""

from iits_mj.envs.startup.iits_mj_gymnasium import declared, register

ENVIRONMENTS = tuple(declared())

register()

__all__ = ["ENVIRONMENTS", "register"]
