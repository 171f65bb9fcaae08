"""Plans the motion of an actor for each kind of maneuver."""

from __future__ import annotations

import math
from collections.abc import Iterable

from traffic_bridge.overrides import Undo
from traffic_bridge.scenario.actions import (
    SHAPES,
    Brake,
    ChangeLane,
    ChangeSpeed,
    CutIn,
    Drift,
    LateralManeuver,
    Maneuver,
    Swerve,
)
from traffic_bridge.scenario.actors import Actor, Approach, Plan, SpeedPlan
from traffic_bridge.scenario.conditions import Body, Situation

# [m/s2], [m/s3] of a change of speed within one step of the traffic
STEP_RATE, STEP_JERK = 1e5, 1e8
HOLD_RATE, HOLD_JERK = 3.0, 30.0  # [m/s2], [m/s3] of a change of speed during a cut-in


def target_lane(event: Maneuver, body: Body, situation: Situation) -> int | None:
    """The lane in which a vehicle ends a maneuver; None if the maneuver is not possible now."""
    truck, route = situation.truck, situation.route
    target = body.lane
    if isinstance(event, CutIn):
        if truck is None:
            return None
        target = truck.lane
    elif isinstance(event, ChangeLane):
        other = body if event.to is None else situation.find(event.to)
        if other is None or (event.lane is None and other.lane < 0):
            return None
        target = event.lane if event.lane is not None else other.lane + (event.relative_lane or 0)
    else:
        return target
    possible = target >= 0 and target != body.lane and route.lane_exists(target, body.front)
    return target if possible else None


def begin(
    event: Maneuver, actor: Actor, target: int, situation: Situation
) -> tuple[list[Plan], Undo]:
    """Begins a maneuver.

    Args:
      event: the maneuver.
      actor: its vehicle.
      target: see `target_lane`.
      situation: now.

    Returns:
      Plans, of which more may follow while one is not done; and what undoes the maneuver.
    """
    plans: list[Plan] = []
    truck = situation.truck
    if isinstance(event, CutIn) and truck is not None:
        _cut_in(event, actor, target, truck, plans)
    elif isinstance(event, LateralManeuver):
        _aside(event, actor, target, plans)
    elif isinstance(event, Drift):
        _drift(event, actor, plans)
    elif isinstance(event, (Brake, ChangeSpeed)):
        return plans, _change_speed(event, actor, situation, plans)
    return plans, lambda: None


def _aside(event: LateralManeuver, actor: Actor, target: int, plans: list[Plan]) -> None:
    assert event.duration is not None
    part, span = SHAPES[event.shape], event.duration
    if isinstance(event, Swerve):
        offset = event.offset
        start = actor.shift

        def swerve(time: float) -> float:
            x = time / span
            if not event.back:
                return start + (offset - start) * part(x)
            return start * (1.0 - part(x)) + offset * part(min(2.0 * x, 2.0 - 2.0 * x))

        plan = actor.plan_shift(swerve, span)
    else:
        actor.to_lane(target, actor.offset)
        start = actor.shift
        plan = actor.plan_shift(lambda t: start * (1.0 - part(t / span)), span)
    plans.append(plan)


def _cut_in(event: CutIn, actor: Actor, target: int, truck: Body, plans: list[Plan]) -> None:
    difference = event.speed_difference

    def change() -> None:
        """Changes lanes at constant speed, and drives on at that speed."""
        speed = actor.speed
        if event.gap is None and difference is not None:
            speed = max(truck.speed + difference, 0.0)
        hold = SpeedPlan(target=speed, rate=HOLD_RATE, jerk=HOLD_JERK, held=True)
        actor.plan_speed(hold)
        actor.desired_speed = speed
        _aside(event, actor, target, plans)

        def release() -> None:
            if actor.speed_plan is hold:
                actor.plan_speed(None)

        plans[-1].then = release

    if event.gap is None:
        change()
        return
    rear = actor.station - 0.5 * actor.row.length
    approach = Approach.of(
        rear - truck.front, actor.speed - truck.speed, event.gap, difference or 0.0, truck.speed
    )
    if approach.duration == 0.0:
        change()
        return
    approach.then = change
    actor.plan_speed(approach)
    plans.append(approach)


def _drift(event: Drift, actor: Actor, plans: list[Plan]) -> None:
    start, span = actor.shift, abs(event.offset) / event.lateral_speed
    rate, back, end = math.copysign(event.lateral_speed, event.offset), event.recovery, event.offset
    sinusoidal = SHAPES["sinusoidal"]

    def shift(time: float) -> float:
        if time < span:
            return start + rate * time
        return (start + end) * (1.0 - sinusoidal((time - span) / back)) if back else start + end

    plans.append(actor.plan_shift(shift, span + back))


def _change_speed(
    event: Brake | ChangeSpeed, actor: Actor, situation: Situation, plans: list[Plan]
) -> Undo:
    before, start = actor.desired_speed, actor.speed
    if isinstance(event, Brake):
        target, rate = min(event.to_speed, actor.speed), event.deceleration
        plan = SpeedPlan(target=target, rate=rate, jerk=event.jerk)
    else:
        other = situation.find(event.to)
        target = (event.speed or 0.0) if other is None else _target_speed(event, other)
        plan = SpeedPlan(target=target, rate=event.acceleration, jerk=event.jerk)
        if event.shape == "step":
            plan.rate, plan.jerk = STEP_RATE, STEP_JERK
        elif event.shape is not None:
            part = SHAPES[event.shape]
            span = event.time or max(abs(target - start) / event.acceleration, 1e-3)
            plan.duration = span
            plan.profile = lambda time: start + (target - start) * part(time / span)
        if event.continuous:
            plan.held = True

            def follow(bodies: Iterable[Body]) -> float | None:
                found = [body for body in bodies if body.name == event.to]
                return _target_speed(event, found[0]) if found else None

            plan.follow = follow
    actor.plan_speed(plan)
    plans.append(plan)
    if event.duration is None:
        return lambda: None

    def undo() -> None:
        actor.desired_speed = before
        if actor.speed_plan is plan:
            actor.plan_speed(None)

    return undo


def _target_speed(event: ChangeSpeed, other: Body) -> float:
    """Speed that an event asks for beside a body [m/s]."""
    if event.speed is not None:
        return event.speed
    if event.speed_factor is not None:
        return event.speed_factor * other.speed
    return max(other.speed + (event.speed_difference or 0.0), 0.0)
