"""Settings of the trajectory planner."""

from __future__ import annotations

from dataclasses import dataclass, field

from controllers.planning.lane_change import LaneChangeConfig
from controllers.planning.merging import MergeConfig
from controllers.planning.safety import SafetyConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.planning.stop_line import LightConfig
from controllers.planning.stopped_vehicle import PullOutConfig
from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError


@dataclass(frozen=True)
class PlannerConfig:
    """All settings of the planner.

    Attributes:
      lanes: indices of the lanes that decisions may lead to; the paper uses two.
      horizon: of the trajectory [s]; step: [s].
      resync_speed: the plan's speed stays within this of the truck's [m/s].
      recover_offset: distance from the plan that makes a new one from where the truck is [m].
      settled_offset: distance from the lane's middle at which a change is complete [m].
      curve_share: of the roll-over threshold, bounds the speed in bends with their cross-slope.
      speed: see `SpeedConfig`; change: see `LaneChangeConfig`; safety: see `SafetyConfig`;
      merge: see `MergeConfig`; light: see `LightConfig`; pull_out: see `PullOutConfig`.

    Raises:
      InputError: a setting cannot be; the message names it.
    """

    lanes: tuple[int, ...] = (0, 1)
    horizon: float = 6.0
    step: float = 0.1
    resync_speed: float = 0.5
    recover_offset: float = 0.8
    settled_offset: float = 0.4
    curve_share: float = 0.38
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    merge: MergeConfig = field(default_factory=MergeConfig)
    light: LightConfig = field(default_factory=LightConfig)
    pull_out: PullOutConfig = field(default_factory=PullOutConfig)

    def __post_init__(self) -> None:
        require_positive(
            self,
            "horizon",
            "step",
            "resync_speed",
            "recover_offset",
            "settled_offset",
            "curve_share",
        )
        if self.horizon < self.step:
            raise InputError(
                f"PlannerConfig: horizon is {self.horizon:g} s: at least one step of "
                f"{self.step:g} s is needed"
            )
