"""Work on several machines: tasks split by seed on a Ray cluster (extra `scale`).

`RayExecutor` is a `concurrent.futures.Executor`; its results are bit-identical to those of the
processes of one machine. `Shards` stores finished work, so that a stopped head resumes with the
rest.
"""

from iits_mj.scale.ray_executor import RayExecutor
from iits_mj.scale.shards import Shards, in_shards

__all__ = ["RayExecutor", "Shards", "in_shards"]
