"""Who slows the truck: engine drag, then engine brake, then retarder, and friction for the rest."""

from __future__ import annotations

from typing import NamedTuple


class EnduranceForces(NamedTuple):
    """What can brake without friction now, as forces at the wheels, zero or positive [N].

    Attributes:
      drag: of the engine, there whenever the accelerator is up; 0 in a gear change.
      engine_brake, retarder: at most.
    """

    drag: float
    engine_brake: float
    retarder: float


class Retardation(NamedTuple):
    """A braking force, shared out.

    Attributes:
      engine_brake, retarder: share of what each can give, 0 to 1.
      short: what is left for friction [N].
    """

    engine_brake: float
    retarder: float
    short: float


def share_out(force: float, endurance: EnduranceForces) -> Retardation:
    """Engine brake first, retarder for what it lacks.

    Args:
      force: wanted at the wheels, positive when it brakes [N].
      endurance: what there is.
    """
    rest = max(force - endurance.drag, 0.0)
    engine_brake, rest = _take(rest, endurance.engine_brake)
    retarder, rest = _take(rest, endurance.retarder)
    return Retardation(engine_brake, retarder, rest)


def _take(force: float, available: float) -> tuple[float, float]:
    """Share of a brake for a force, and what it leaves over."""
    if available <= 0.0:
        return 0.0, force
    share = min(force / available, 1.0)
    return share, max(force - available, 0.0)


def xbr_deceleration(
    deceleration: float, level: float, correction_max: float, correction_share: float
) -> float:
    """Deceleration to demand by XBR so that the brakes reach a braking level [m/s2].

    The demand is what the truck shall decelerate by, as SPN 2920 has it. Brake control feeds it
    forward as on the level road and corrects it by what it measures, by at most
    `correction_max + correction_share * demand` and at most by the demand itself. On a descent,
    where braking keeps the speed, that is not enough for a demand near zero: it is then the least
    one whose correction reaches the level.

    Args:
      deceleration: of the truck along the road, positive when it slows.
      level: deceleration that the whole braking force would give on the level.
      correction_max: bound of brake control's correction [m/s2].
      correction_share: what the demand adds to that bound [1].
    """
    least = max(0.5 * level, (level - correction_max) / (1.0 + correction_share))
    return max(deceleration, least, 0.0)
