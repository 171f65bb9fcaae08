"""Tasks on several machines: split by seed on a Ray cluster (extra `scale`).

`RayExecutor` is a `concurrent.futures.Executor`; its results are bit-identical to those of the
processes of one machine. `Shards` stores finished tasks, so that a new head resumes with the
remaining ones.
"""

from iits_mj.scale.ray_executor import RayExecutor
from iits_mj.scale.shards import Shards, in_shards

__all__ = ["RayExecutor", "Shards", "in_shards"]
