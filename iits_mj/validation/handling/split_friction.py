"""Full braking on split friction (ISO 16234; bounds of UN R13, annex 13): 0.8 left, 0.3 right.

The driver pursues a point of the lane's middle a second ahead, 0.2 s late (pure pursuit). The same
is braked without any steering, for two seconds, and on each of the two surfaces alone.

ISO 16234 is the open-loop method for heavy vehicles and their combinations; our reaction with the
steering wheel held is its figure. The bounds with a driver (braking rate, 120 and 240 degrees) and
their clauses are known to us without the text of UN R13 at hand; there they are asked of the laden
towing vehicle, here of the whole combination, laden and empty.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from iits_mj.analytic import Kinematic
from iits_mj.core.messages import EgoState
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.handling.braking_run import BrakingRun, brake
from iits_mj.validation.harness.recorder import PERIOD, run_straight

HIGH, LOW = 0.8, 0.3
SPEED = 50.0 * KMH
# More than either surface allows, so that ABS works [m/s2].
DEMAND = 8.0
# UN R13, annex 13, 5.3.6: steering-wheel angle in the first 2 s and in all [deg].
STEER_EARLY, STEER_TOTAL = 120.0, 240.0
# UN R13, annex 13, 5.3.5: least braking rate as a share of gravity, 0.75 (4 k_L + k_H) / 5 and at
# least k_L, between these speeds [m/s] as its appendix has it, the brakes being built up.
RATE = max(0.75 * (4.0 * LOW + HIGH) / 5.0, LOW)
_FROM, _TO = 40.0 * KMH, 20.0 * KMH
_LONG = 30.0
# The driver: reaction [s], preview [s] and its least distance [m].
_DELAY, _PREVIEW, _NEAR = 0.2, 1.0, 5.0
# Half the outer track: beyond it the tires of one side cross the split (UN R13) [m].
_ASTRIDE = 1.0

Steering = Callable[[float, EgoState], float]


def lane_keeper(ratio: float, wheelbase: float) -> Steering:
    """A driver who steers, late, on the arc that meets y = 0 at the preview."""
    waiting: deque[float] = deque([0.0] * round(_DELAY / PERIOD))

    def steering(_: float, state: EgoState) -> float:
        reach = max(_PREVIEW * state.speed, _NEAR)
        aside = state.y * np.cos(state.yaw) + reach * np.sin(state.yaw)
        waiting.append(-ratio * wheelbase * 2.0 * aside / reach**2)
        return float(np.clip(waiting.popleft(), -10.0, 10.0))

    return steering


def stop_on(
    payload: float, left: float, right: float, timestep: float, *, driver: bool, duration: float
) -> BrakingRun:
    """Brakes from `SPEED` on a straight road with these coefficients of friction."""
    route = Route.straight(2000.0).with_friction(left, right)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    run_straight(truck, SPEED)
    parameters = truck.parameters
    keeper = lane_keeper(parameters.steering.ratio, Kinematic.from_parameters(parameters).L)
    steering = keeper if driver else _straight
    return brake(
        truck, DEMAND, steering, duration=duration, stop=lambda state: state.speed < 0.5 * KMH
    )


def _straight(_: float, __: EgoState) -> float:
    return 0.0


def braking_rate(run: BrakingRun) -> float:
    """Mean deceleration over distance between `_FROM` and `_TO` as a share of gravity [1]."""
    inside = (run.speed <= _FROM) & (run.speed >= _TO)
    x, y, speed = run.x[inside], run.y[inside], run.speed[inside]
    distance = float(np.sum(np.hypot(np.diff(x), np.diff(y))))
    return float((speed[0] ** 2 - speed[-1] ** 2) / (2.0 * distance * GRAVITY))


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Checks and panels for one payload [kg]."""
    label = f"split friction {HIGH:g}/{LOW:g}, {payload / 1e3:g} t, 50 km/h"
    held = stop_on(payload, HIGH, LOW, timestep, driver=True, duration=_LONG)
    free = stop_on(payload, HIGH, LOW, timestep, driver=False, duration=2.0)
    high, low = (
        stop_on(payload, mu, mu, timestep, driver=True, duration=_LONG).distance()
        for mu in (HIGH, LOW)
    )
    wheel = np.abs(np.rad2deg(held.steering_wheel))
    worst = float(np.max(np.abs(np.rad2deg(held.articulation))))
    checks = [
        Check(f"{label}: stopping distance", held.distance(), "m", None, f"<= {low:.1f}"),
        Check(f"{label}: stopping distance on {HIGH:g} alone", high, "m"),
        Check(f"{label}: stopping distance on {LOW:g} alone", low, "m"),
        Check(
            f"{label}: braking rate 40 to 20 km/h (UN R13)",
            braking_rate(held),
            "g",
            None,
            f">= {RATE:g}",
        ),
        Check(
            f"{label}: steering wheel in the first 2 s (UN R13)",
            float(wheel[held.time <= 2.0].max()),
            "deg",
            None,
            f"<= {STEER_EARLY:g}",
        ),
        Check(
            f"{label}: steering wheel in all (UN R13)",
            float(wheel.max()),
            "deg",
            None,
            f"<= {STEER_TOTAL:g}",
        ),
        Check(f"{label}: deviation", float(np.max(np.abs(held.y))), "m", None, f"<= {_ASTRIDE:g}"),
        Check(f"{label}: greatest hitch angle", worst, "deg", None, "<= 5"),
        Check(
            f"{label}: greatest yaw rate",
            float(np.max(np.abs(np.rad2deg(held.yaw_rate)))),
            "deg/s",
        ),
        Check(
            f"{label}: change of heading in 2 s, wheel held",
            float(np.rad2deg(free.yaw[-1] - free.yaw[0])),
            "deg",
        ),
    ]
    straight = Line("straight on", held.time[[0, -1]], np.zeros(2), "reference")
    return checks, [
        Panel(
            f"{label}: lateral position",
            "time [s]",
            "deviation [m]",
            (straight, Line("driver", held.time, held.y, "simulation")),
        ),
        Panel(
            f"{label}: heading",
            "time [s]",
            "yaw [deg]",
            (
                straight,
                Line("driver", held.time, np.rad2deg(held.yaw), "simulation"),
                Line("steering wheel held", free.time, np.rad2deg(free.yaw)),
            ),
        ),
        Panel(
            f"{label}: steering wheel",
            "time [s]",
            "angle [deg]",
            (straight, Line("driver", held.time, np.rad2deg(held.steering_wheel), "simulation")),
        ),
    ]
