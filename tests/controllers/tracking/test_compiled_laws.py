"""The compiled laws of tracking give the bits of their Python form, on any processor."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest

from controllers.tracking.lateral import LateralController
from controllers.tracking.lateral_gains import LateralConfig
from controllers.tracking.longitudinal import LongitudinalController, Phase
from iits_mj.core.angles import wrap_angles
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.parameters import TruckParameters
from tests.controllers.tracking.reference import Steering
from tests.controllers.tracking.speed_reference import SpeedLaw
from tests.controllers.tracking.test_lateral import arc
from tests.controllers.tracking.test_longitudinal import plan

PARAMETERS = TruckParameters.load()
CONFIG = LateralConfig(speed_grid=(2.0, 10.0, 20.0))


def winding(rng, count=61):
    """A path of random bends and steps, some of them of no length, whose yaw wraps."""
    step = rng.uniform(0.0, 2.5, count) * (rng.uniform(size=count) > 0.05)
    yaw = np.cumsum(rng.normal(0.0, 0.02, count)) + rng.choice([0.0, 3.1])
    path = arc(step=1.0, length=count - 1.0)
    return dataclasses.replace(
        path,
        station=np.cumsum(step),
        x=np.cumsum(step * np.cos(yaw)),
        y=np.cumsum(step * np.sin(yaw)),
        yaw=wrap_angles(yaw),
        curvature=rng.normal(0.0, 0.01, count),
    )


def somewhere(rng, path, units=2):
    """A truck near a path, at times at standstill, before its start or beyond its end."""
    at = int(rng.integers(len(path.x)))
    speed, lateral, turn, trailer = rng.normal((12.0, 0.0, 0.0, 0.0), (8.0, 0.3, 0.1, 0.1))
    return EgoState(
        x=path.x[at] + rng.normal(),
        y=path.y[at] + rng.normal(),
        yaw=path.yaw[at] + rng.normal(0.0, 0.1),
        station=path.station[at] + rng.choice([0.0, rng.normal(0.0, 20.0)]),
        speed=speed,
        lateral_speed=lateral,
        yaw_rate=turn,
        trailer_yaw_rate=trailer,
        articulation=rng.normal(0.0, 0.2),
        rear_articulations=tuple(rng.normal(0.0, 0.2, max(units - 2, 0))),
        articulation_rate=0.03,
        rear_articulation_rates=tuple(rng.normal(0.0, 0.1, max(units - 2, 0))),
        steering_wheel_angle=rng.normal(0.0, 0.5),
        road_wheel_angle=rng.normal(0.0, 0.03),
        mass=40_000.0,
    )


@pytest.mark.parametrize("lag", [0.05, 0.12, 0.4])
def test_steering_equals_its_python_form_to_the_bit(lag):
    rng = np.random.default_rng(round(100 * lag))
    config = dataclasses.replace(CONFIG, lag=lag)
    compiled, python = LateralController(PARAMETERS, config), Steering(PARAMETERS, config)
    for _ in range(8):
        compiled.reset()
        python.reset()
        for k in range(24):
            if k % 4 == 0:
                path = winding(rng)
            ego = somewhere(rng, path)
            assert compiled.steer(ego, path) == python.steer(ego, path)
        memory = compiled.memory
        assert (memory.demand, memory.integral) == (python.demand, python.integral)
        _, disturbance, lasting = compiled.observed.tolist()
        assert (disturbance, lasting) == (python.observer.value.tolist(), python.lasting.tolist())


@pytest.mark.parametrize("name", ["vecto_tractor", "b_double", "a_double"])
def test_steering_of_one_to_four_units_equals_its_python_form_to_the_bit(name):
    truck, rng = TruckParameters.load(name), np.random.default_rng(len(name))
    compiled, python = LateralController(truck, CONFIG), Steering(truck, CONFIG)
    for k in range(60):
        if k % 4 == 0:
            path = winding(rng)
        ego = somewhere(rng, path, len(truck.units))
        assert compiled.steer(ego, path) == python.steer(ego, path)
    assert compiled.observed[1].tolist() == python.observer.value.tolist()


def test_in_calm_the_wheel_rests_and_moves_as_in_its_python_form_to_the_bit():
    rng, speed = np.random.default_rng(5), 20.0
    compiled, python = LateralController(PARAMETERS, CONFIG), Steering(PARAMETERS, CONFIG)
    station = np.arange(0.0, 400.0)
    bend = 1e-3 * np.clip((station - 120.0) / 80.0, 0.0, 1.0)
    yaw = np.cumsum(bend)
    path = dataclasses.replace(
        arc(step=1.0, length=399.0),
        station=station,
        x=np.cumsum(np.cos(yaw)),
        y=np.cumsum(np.sin(yaw)),
        yaw=yaw,
        curvature=bend,
    )
    wheel = offset = 0.0
    rests, turning = [], []
    for k in range(700):
        place = 5.0 + speed * 0.02 * k
        heading, curvature = (float(np.interp(place, station, row)) for row in (yaw, bend))
        offset = 0.99 * offset + rng.normal(0.0, 1e-3)
        turned = rng.normal(0.0, 1e-4) - (4e-4 if 150 < k < 200 else 0.0)
        ego = EgoState(
            x=float(np.interp(place, station, path.x)) - offset * math.sin(heading),
            y=float(np.interp(place, station, path.y)) + offset * math.cos(heading),
            yaw=heading + turned,
            station=place,
            speed=speed,
            yaw_rate=speed * curvature,
            trailer_yaw_rate=speed * curvature,
            steering_wheel_angle=wheel,
            road_wheel_angle=wheel / PARAMETERS.steering.ratio,
            mass=40_000.0,
        )
        wheel = compiled.steer(ego, path)
        assert wheel == python.steer(ego, path)
        memory = compiled.memory
        assert (memory.strength, memory.drift) == (python.rest.strength, python.rest.drift)
        assert bool(memory.resting) == python.rest.resting
        rests.append(memory.resting)
        turning.append(python.rest.quiet < 0.5)
    # The wheel comes to rest and leaves it again several times; the clothoid counts as one.
    assert np.count_nonzero(np.diff(rests)) >= 4
    assert any(turning)


@pytest.mark.parametrize("left", [1.0, -1.0])
def test_in_a_bend_tighter_than_the_truck_turns_the_wheel_ends_at_its_stop(left):
    path, stop = arc(radius=2.0, length=12.0), PARAMETERS.steering.angle_max
    path = dataclasses.replace(path, y=left * path.y, yaw=left * path.yaw)
    path = dataclasses.replace(path, curvature=left * path.curvature)
    compiled, python = LateralController(PARAMETERS, CONFIG), Steering(PARAMETERS, CONFIG)
    ego = EgoState(y=-4.0 * left, yaw=-0.5 * left, speed=2.0, mass=40_000.0)
    for _ in range(400):
        wheel = compiled.steer(ego, path)
        assert wheel == python.steer(ego, path)
        assert abs(wheel) <= stop
        road_wheel = wheel / PARAMETERS.steering.ratio
        ego = dataclasses.replace(ego, steering_wheel_angle=wheel, road_wheel_angle=road_wheel)
    assert wheel == left * stop


@pytest.mark.parametrize("points", [1, 2, 20, 60])
def test_a_whole_turn_of_the_first_points_of_a_path_changes_nothing(points):
    path, rng = arc(step=1.0), np.random.default_rng(5)
    turned = dataclasses.replace(path, yaw=path.yaw.copy())
    turned.yaw[:points] -= 2.0 * math.pi
    plain, other = (LateralController(PARAMETERS, CONFIG) for _ in range(2))
    for _ in range(40):
        ego = dataclasses.replace(somewhere(rng, path), station=rng.uniform(-1.0, 3.0))
        assert other.steer(ego, turned) == pytest.approx(plain.steer(ego, path), abs=1e-9)


def driving(rng):
    """A truck somewhere in its range of speeds, at times at a corner of a table, or shifting."""
    engine = PARAMETERS.engine
    corners = [*engine.pedal_map.rows, *engine.drag_speed, engine.engine_brake_speed_min]
    return EgoState(
        time=rng.choice([rng.uniform(-1.0, 6.0), 1.0, 5.0]),
        speed=rng.choice([0.0, rng.normal(0.0, 0.2), *rng.uniform(0.0, [8.0, 8.0, 28.0, 28.0])]),
        mass=rng.uniform(15e3, 60e3),
        engine_speed=rng.choice([rng.uniform(0.0, 280.0), rng.choice(corners)]),
        gear=int(rng.integers(-1, 14)),
        shift_in_process=rng.uniform() < 0.1,
    )


def test_the_speed_law_equals_its_python_form_to_the_bit():
    compiled, python = LongitudinalController(PARAMETERS), SpeedLaw(PARAMETERS)
    rng, phases = np.random.default_rng(4), set()
    for k in range(30_000):
        # Most stretches are long and near a balance, the last steps of each are not.
        if k % 150 == 0:
            ego, grade = driving(rng), rng.choice([rng.normal(0.0, 0.04), rng.normal(-0.01, 0.004)])
            speed = rng.choice([0.0, *(ego.speed + rng.normal(0.0, [0.2, 0.2, 1.0]))])
            path = plan(speed, rng.choice([0.0, 0.0, *rng.normal([0.0, -0.6], 0.5), -9.0]))
            path.acceleration[:] += rng.normal(0.0, rng.choice([0.003, 0.05]), len(path.time))
        if k % 10 == 0:
            ego = dataclasses.replace(ego, time=rng.uniform(-1.0, 6.0))
            path.speed[:] += rng.normal(0.0, 0.05)
            path = dataclasses.replace(path)
        if k % 150 == 140:
            ego = dataclasses.replace(driving(rng), mass=ego.mass, speed=ego.speed)
        command = compiled.command(ego, path, grade, 0.1)
        assert command == python.command(ego, path, grade, 0.1)
        assert compiled.phase is python.phase
        memory, kept = compiled.memory, (python._since, python._integral, python._gear)
        assert (memory.since, memory.integral, memory.gear) == kept
        phases.add(compiled.phase)
    assert phases == set(Phase)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_steers_on_alone(copied):
    path, rng = arc(), np.random.default_rng(1)
    first = LateralController(PARAMETERS, CONFIG)
    states = [somewhere(rng, path) for _ in range(20)]
    for ego in states[:10]:
        first.steer(ego, path)
    second = copied(first)
    wheels = [first.steer(ego, path) for ego in states[10:]]
    assert [second.steer(ego, path) for ego in states[10:]] == wheels


def test_a_path_of_one_point_is_refused():
    path = arc()
    names = ("station", "x", "y", "yaw", "curvature")
    short = {name: getattr(path, name)[:1] for name in names}
    with pytest.raises(InputError, match="1 point"):
        LateralController(PARAMETERS, CONFIG).steer(EgoState(), dataclasses.replace(path, **short))


def test_a_plan_without_points_is_refused():
    empty = dataclasses.replace(plan(9.0), **dict.fromkeys(("time", "speed"), np.zeros(0)))
    with pytest.raises(InputError, match="without points"):
        LongitudinalController(PARAMETERS).command(EgoState(), empty, 0.0)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_holds_the_speed_alone(copied):
    rng, path = np.random.default_rng(1), plan(12.0)
    first, states = LongitudinalController(PARAMETERS), [driving(rng) for _ in range(20)]
    for ego in states[:10]:
        first.command(ego, path, 0.01)
    second = copied(first)
    commands = [first.command(ego, path, 0.01) for ego in states[10:]]
    assert [second.command(ego, path, 0.01) for ego in states[10:]] == commands


def test_states_that_are_not_finite_do_not_crash():
    controller, path = LateralController(PARAMETERS, CONFIG), arc()
    for value in (math.nan, math.inf, -math.inf):
        controller.steer(EgoState(station=value, speed=value, x=value), path)
        ego = EgoState(time=value, speed=value, engine_speed=value, mass=value)
        LongitudinalController(PARAMETERS).command(ego, path, value)
