"""Plans the motion of an actor for each kind of maneuver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from scipy.interpolate import PchipInterpolator

from traffic_bridge.overrides import Undo
from traffic_bridge.scenario import actions as do
from traffic_bridge.scenario.actors import (
    HARDEST,
    Actor,
    Approach,
    Course,
    Law,
    Plan,
    SpeedPlan,
    Timetable,
)
from traffic_bridge.scenario.conditions import SLOWEST, Body, Situation
from traffic_bridge.scenario.paths import Path

# [m/s2], [m/s3] of a change of speed within one step of the traffic
STEP_RATE, STEP_JERK = 1e5, 1e8
# Gains of the errors of distance [1/s2] and speed [1/s] of a vehicle that keeps a distance; they
# damp its motion critically: SPEED_GAIN = 2 sqrt(GAP_GAIN) (judgement).
GAP_GAIN, SPEED_GAIN = 0.16, 0.8
REACHED = 0.1  # [m], [m/s]: errors at which a distance is reached
SHORTEST = 0.1  # [s] of a motion to the side
HOLD_RATE, HOLD_JERK = 3.0, 30.0  # [m/s2], [m/s3] of a change of speed during a cut-in


def target_lane(
    event: do.Maneuver, body: Body, situation: Situation, actor: Actor | None, own: Callable
) -> int | None:
    """The lane in which a vehicle ends a maneuver; None if the maneuver is not possible now.

    Args:
      event: the maneuver.
      body: its vehicle.
      situation: now.
      actor: the vehicle, if it is one.
      own: returns the lane of a vehicle on the actor's own road by its name, None if it is not on
        it.
    """
    truck = situation.truck
    joined = actor is None or actor.track is situation.route
    lane = body.lane if actor is None or joined else actor.lane
    if isinstance(event, do.CutIn):
        if truck is None or (body.lane < 0 and not joined):
            return None
        target, joined, lane = truck.lane, True, body.lane
    elif isinstance(event, do.ChangeLane) and event.lane is not None:
        target = event.lane
    elif isinstance(event, do.ChangeLane):
        name = body.name if event.to is None else event.to
        other = None if joined else lane if name == body.name else own(name)
        if other is None:
            found = situation.find(name)
            if found is None or found.lane < 0 or (body.lane < 0 and not joined):
                return None
            other, joined, lane = found.lane, True, body.lane
        target = other + (event.relative_lane or 0)
    else:
        return lane
    if joined:
        possible = situation.route.lane_exists(target, body.front)
    else:
        assert actor is not None
        possible = not isinstance(actor.track, Path) and actor.track.lane_exists(
            target, actor.front
        )
    return target if target >= 0 and target != lane and possible else None


def begin(
    event: do.Maneuver, actor: Actor, target: int, situation: Situation
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
    if isinstance(event, do.CutIn) and truck is not None:
        _cut_in(event, actor, target, truck, plans)
    elif isinstance(event, do.LateralManeuver):
        _aside(event, actor, target, plans)
    elif isinstance(event, do.Drift):
        _drift(event, actor, plans)
    elif isinstance(event, (do.Brake, do.ChangeSpeed)):
        return plans, _change_speed(event, actor, situation, plans)
    elif isinstance(event, do.FollowSpeeds):
        plans.append(_follow_speeds(event, actor, situation.find(event.to)))
    elif isinstance(event, do.KeepDistance) and event.ahead and truck is not None:
        goal = float(event.gap or 0.0), event.speed_difference
        plans.append(_approach(actor, truck, *goal, hardest=event.acceleration))
        actor.plan_speed(plans[0])  # type: ignore[arg-type]
        plans[0].done = plans[0].duration == 0.0
    elif isinstance(event, do.KeepDistance):
        _keep_distance(event, actor, plans)
    elif isinstance(event, do.ActivateDriver):
        actor.activate(event.active)
        plans.append(Plan(done=True))
    return plans, lambda: None


def _aside(event: do.LateralManeuver, actor: Actor, target: int, plans: list[Plan]) -> None:
    part = do.SHAPES[event.shape]
    if isinstance(event, do.Swerve):
        offset = event.offset
        start = actor.shift
        span = _span(event, offset - start, actor.speed)
        if event.back and event.duration is None and event.distance is None:
            span *= 2.0

        def swerve(time: float) -> float:
            x = time / span
            if not event.back:
                return start + (offset - start) * part(x)
            return start * (1.0 - part(x)) + offset * part(min(2.0 * x, 2.0 - 2.0 * x))

        plan = actor.plan_shift(swerve, span)
    else:
        actor.to_lane(target, actor.offset)
        start = actor.shift
        span = _span(event, start, actor.speed)
        plan = actor.plan_shift(lambda t: start * (1.0 - part(t / span)), span)
    plans.append(plan)


def _span(event: do.LateralManeuver, way: float, speed: float) -> float:
    """Time of a motion to the side by a way [m] at a speed [m/s]."""
    if event.lateral_speed is not None:
        return max(do.STEEPEST[event.shape] * abs(way) / event.lateral_speed, SHORTEST)
    if event.lateral_acceleration is not None:
        span = math.sqrt(do.BENDS[event.shape] * abs(way) / event.lateral_acceleration)
        return max(span, SHORTEST)
    if event.distance is not None:
        return max(event.distance / max(speed, SLOWEST), SHORTEST)
    return event.duration or SHORTEST


def _cut_in(event: do.CutIn, actor: Actor, target: int, truck: Body, plans: list[Plan]) -> None:
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
    approach = _approach(actor, truck, event.gap, difference or 0.0)
    if approach.duration == 0.0:
        change()
        return
    approach.then = change
    actor.plan_speed(approach)
    plans.append(approach)


def _approach(actor: Actor, truck: Body, gap: float, final: float, **more: float) -> Approach:
    """The way of an actor to a gap ahead of the truck [m], which it reaches at a rate [m/s]."""
    rear = actor.station - 0.5 * actor.row.length
    closing = actor.speed - truck.speed
    return Approach.of(rear - truck.front, closing, gap, final, truck.speed, **more)


def _drift(event: do.Drift, actor: Actor, plans: list[Plan]) -> None:
    start, span = actor.shift, abs(event.offset) / event.lateral_speed
    rate, back, end = math.copysign(event.lateral_speed, event.offset), event.recovery, event.offset
    sinusoidal = do.SHAPES["sinusoidal"]

    def shift(time: float) -> float:
        if time < span:
            return start + rate * time
        return (start + end) * (1.0 - sinusoidal((time - span) / back)) if back else start + end

    plans.append(actor.plan_shift(shift, span + back))


def _change_speed(
    event: do.Brake | do.ChangeSpeed, actor: Actor, situation: Situation, plans: list[Plan]
) -> Undo:
    before, start = actor.desired_speed, actor.speed
    if isinstance(event, do.Brake):
        target, rate = min(event.to_speed, actor.speed), event.deceleration
        plan = SpeedPlan(target=target, rate=rate, jerk=event.jerk)
    else:
        other = situation.find(event.to)
        target = (event.speed or 0.0) if other is None else _target_speed(event, other)
        rate = (target < start and event.deceleration) or event.acceleration
        plan = SpeedPlan(target=target, rate=rate, jerk=event.jerk)
        if event.shape == "step":
            plan.rate, plan.jerk = STEP_RATE, STEP_JERK
        elif event.shape is not None:
            part = do.SHAPES[event.shape]
            span = event.time or max(abs(target - start) / plan.rate, 1e-3)
            if event.distance is not None:
                # All shapes have the mean of both speeds as their mean speed.
                span = 2.0 * event.distance / max(start + target, SLOWEST)
            plan.duration = span
            plan.profile = lambda time: start + (target - start) * part(time / span)
        if event.continuous:
            plan.held = True

            def follow(bodies: Iterable[Body]) -> float | None:
                found = [body for body in bodies if body.name == event.to]
                return _target_speed(event, found[0]) if found else None

            plan.follow = follow
    if not plan.held:
        actor.desired_speed = plan.target
    actor.plan_speed(plan)
    plans.append(plan)
    if event.duration is None:
        return lambda: None

    def undo() -> None:
        actor.desired_speed = before
        if actor.speed_plan is plan:
            actor.plan_speed(None)

    return undo


def _follow_speeds(event: do.FollowSpeeds, actor: Actor, other: Body | None) -> Plan:
    base = other.speed if event.relative and other is not None else 0.0
    times, speeds = np.array([(0.0, actor.speed - base), *event.speeds]).T
    speeds = np.maximum(speeds + base, 0.0)
    plan = SpeedPlan(target=float(speeds[-1]), rate=STEP_RATE, jerk=STEP_JERK)
    plan.duration = float(times[-1])
    plan.profile = lambda time: float(np.interp(time, times, speeds))
    actor.desired_speed = plan.target
    actor.plan_speed(plan)
    return plan


def _target_speed(event: do.ChangeSpeed, other: Body) -> float:
    """Speed that an event asks for beside a body [m/s]."""
    if event.speed is not None:
        return event.speed
    if event.speed_factor is not None:
        return event.speed_factor * other.speed
    return max(other.speed + (event.speed_difference or 0.0), 0.0)


def _keep_distance(event: do.KeepDistance, actor: Actor, plans: list[Plan]) -> None:
    plan = Law()

    def accelerate(bodies: Iterable[Body], step: float) -> float | None:
        ahead = next((body for body in bodies if body.name == event.to), None)
        found = None if ahead is None else next(iter(actor.sees([ahead])), None)
        if found is None:
            return None
        wanted = event.gap if event.gap is not None else event.time_gap * actor.speed  # type: ignore
        gap = (found.rear if event.freespace else found.front) - actor.front
        error, closing = gap - wanted, actor.speed - found.pace
        plan.done = not event.continuous and abs(error) < REACHED and abs(closing) < REACHED
        wish = GAP_GAIN * error - SPEED_GAIN * closing
        wish = min(max(wish, -event.deceleration), event.acceleration)
        return max(min(wish, (event.fastest - actor.speed) / step), -event.deceleration)

    plan.acceleration = accelerate
    actor.plan_speed(plan)
    plans.append(plan)


def synchronize(
    event: do.Synchronize, actor: Actor, place_of: Callable[[], tuple[float, float] | None]
) -> list[Plan]:
    """Begins a synchronized motion.

    Args:
      event: the maneuver.
      actor: its vehicle.
      place_of: returns the station of the other's front bumper [m] and its speed [m/s]; None if it
        is not there.

    Returns:
      The plan.
    """
    plan = Law()

    def accelerate(bodies: Iterable[Body], step: float) -> float | None:
        del bodies
        found = place_of()
        if found is None:
            return None
        way, others = event.station - actor.front, event.to_station - found[0]
        final = event.speed
        if event.speed_difference is not None:
            final = max(found[1] + event.speed_difference, 0.0)
        speed = actor.speed
        if way <= event.tolerance or others <= event.to_tolerance:
            plan.done = True
            return 0.0 if final is None else min(max((final - speed) / step, -HARDEST), HARDEST)
        if found[1] < SLOWEST:
            # The other does not arrive: it waits before its station.
            return -min(HARDEST, 0.5 * speed**2 / way)
        span = max(others / found[1], step)
        if final is None:
            wish = 2.0 * (way - speed * span) / span**2
        else:
            motion = Approach(closing=speed, goal=way, final=final, duration=span)
            wish = motion.at(0.5 * step)[2]
        return min(max(wish, -HARDEST), HARDEST)

    plan.acceleration = accelerate
    actor.plan_speed(plan)
    return [plan]


def follow(event: do.FollowPath, actor: Actor, path: Path, numbers: list[int]) -> list[Plan]:
    """Leads an actor onto a path.

    Args:
      event: the maneuver.
      actor: its road user.
      path: of the event's points.
      numbers: of those points among the path's.

    Returns:
      The plan.
    """
    times = event.times
    goal = event.goal if event.goal is not None else len(times or numbers) - 1
    if times is None:
        row = actor.vehicle()
        place = path.locate(row.x, row.y)
    else:
        place = 0.0, 0.0
        stations = path.stations[numbers[: len(times)]]
        way = PchipInterpolator(np.array(times), stations)
        last = times[-1]
        at = lambda t: float(way(min(max(t, times[0]), last)))  # noqa: E731
        actor.plan_speed(Timetable(at=at, duration=last))
    actor.take(path, place, stays=event.stays)
    actor.course = Course(goal=float(path.stations[numbers[goal]]))
    return [actor.course]
