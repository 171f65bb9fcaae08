"""More than one machine: the same work, split by seed, on a Ray cluster (extra `scale`).

`RayExecutor` is a `concurrent.futures.Executor`; what is done by processes of one machine is done
by those of many, and gives the same bits. `Shards` keeps what is done, so that a head that was
stopped goes on with the rest.
"""

from iits_mj.scale.ray_executor import RayExecutor
from iits_mj.scale.shards import Shards, in_shards

__all__ = ["RayExecutor", "Shards", "in_shards"]
