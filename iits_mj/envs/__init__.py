"""Gymnasium environments, registered when this module is imported.

`gymnasium.make("iits_mj.envs:iits_mj/Cruise-v0")` imports it by itself; after `import iits_mj.envs`
the short name is enough. (Gymnasium 1.x no longer reads the entry point that older versions did.)

| id                      | decides on          | class                            |
|-------------------------|---------------------|----------------------------------|
| `iits_mj/Cruise-v0`     | pedal and brakes    | `iits_mj.envs.driving.CruiseEnv` |
| `iits_mj/LaneKeep-v0`   | and steering wheel  | `iits_mj.envs.driving.LaneKeepEnv` |
| `iits_mj/Highway-v0`    | lane changes        | `iits_mj.envs.highway.HighwayEnv` |
"""

from __future__ import annotations

import gymnasium

ENVIRONMENTS = {
    "iits_mj/Cruise-v0": "iits_mj.envs.driving:CruiseEnv",
    "iits_mj/LaneKeep-v0": "iits_mj.envs.driving:LaneKeepEnv",
    "iits_mj/Highway-v0": "iits_mj.envs.highway:HighwayEnv",
}


def register() -> None:
    """Registers the environments; repeated calls do nothing."""
    for name, entry in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=entry)


register()

__all__ = ["ENVIRONMENTS", "register"]
