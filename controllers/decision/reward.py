"""The paper's reward with its signs repaired, term by term.

`r = r_ch + r_v + r_sa`: -10 for a decision to change lanes (also one that is refused), minus the
distance of the speed from the reference for each second (the paper prints it with the wrong sign),
-20 for a decision to change at a dangerous moment. A collision, which the paper does not charge,
ends the trip, and an end would otherwise be worth more than any future of charges.
"""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the terms.

    Attributes:
      change: charge of a decision to change lanes; danger: further charge when it is dangerous.
      speed: charge for each second and m/s of distance from the reference speed.
      collision: charge of a collision.
      discount: of a reward one second later.
    """

    change: float = 10.0
    danger: float = 20.0
    speed: float = 1.0
    collision: float = 300.0
    discount: float = 0.99


@dataclass(frozen=True)
class RewardTerms:
    """The terms of one decision, discounted to its instant; all zero or negative."""

    change: float = 0.0
    speed: float = 0.0
    danger: float = 0.0
    collision: float = 0.0

    @property
    def total(self) -> float:
        """Their sum."""
        return self.change + self.speed + self.danger + self.collision

    def __add__(self, other: RewardTerms) -> RewardTerms:
        """Adds term by term."""
        names = [field.name for field in fields(self)]
        return RewardTerms(**{n: getattr(self, n) + getattr(other, n) for n in names})


def decision_charge(changes: bool, dangerous: bool, config: RewardConfig) -> RewardTerms:
    """Charge of the decision itself, at its instant."""
    return RewardTerms(
        change=-config.change if changes else 0.0,
        danger=-config.danger if changes and dangerous else 0.0,
    )


def speed_charge(speed: float, reference: float, elapsed: float, config: RewardConfig) -> float:
    """Charge of one second at a speed [m/s], `elapsed` seconds after the decision."""
    return -config.speed * abs(speed - reference) * config.discount**elapsed
