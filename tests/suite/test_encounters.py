import math

import numpy as np
import pytest

from iits_mj import suite
from iits_mj.suite.tasks.encounters import OTHER, wanted_speed


def load(task, seed):
    return suite.load("truck", task, {"random": seed, "visuals": False})


def play(environment, act):
    """Steps of an episode: time, gap, beside, whether the car is in the way, its acceleration."""
    step, rows = environment.reset(), []
    while not step.last():
        step = environment.step(act(step.observation))
        task, physics = environment.task, environment.physics
        rows.append(
            (
                physics.time(),
                task.gap(physics),
                task.beside(physics),
                task.in_way(physics),
                task.car_acceleration(physics),
            )
        )
    return step, rows


def coast(_):
    return np.array([0.3])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_car_cuts_in_from_the_left_within_the_drawn_gap(seed):
    environment = load("cut_in", seed)
    _, rows = play(environment, suite.DRIVERS["cut_in"])
    assert rows[0][2] == pytest.approx(4.0, abs=0.1)
    assert not rows[0][3]
    first = next(k for k, row in enumerate(rows) if row[3])
    cut_in = environment.task._traffic.config.events[1]
    time, gap = rows[first][:2]
    assert cut_in.at_time < time < cut_in.at_time + 8.0
    # It drives at most 6 m/s slower while it changes lanes, and the truck slows down, too.
    assert cut_in.gap - 6.0 * cut_in.duration < gap < cut_in.gap + 5.0


def test_who_drives_on_hits_the_braking_car_and_who_brakes_at_once_does_not():
    environment = load("emergency_stop", 4)
    step, rows = play(environment, coast)
    assert step.discount == 0.0
    assert rows[-1][1] < 1.0
    environment = load("emergency_stop", 4)
    step, rows = play(
        environment, lambda seen: np.array([-1.0 if seen["car_acceleration"][0] < -0.5 else 0.0])
    )
    assert step.discount == 1.0
    assert min(row[1] for row in rows) > 5.0


def test_the_car_is_shown_where_it_is():
    environment = load("cut_in", 5)
    environment.reset()
    for _ in range(30):
        environment.step(np.zeros(1))
    physics, vehicle = environment.physics, environment.task.vehicle
    (name,) = environment.task._mirror.bodies_of(OTHER)
    mocap = physics.model.body(name).mocapid[0]
    shown = physics.data.mocap_pos[mocap]
    assert math.dist(shown[:2], (vehicle.x, vehicle.y)) < 1e-9


def test_the_wanted_speed_is_the_cars_at_the_wanted_gap():
    assert wanted_speed(22.0, 150.0, 10.0, in_way=False) == 22.0
    assert wanted_speed(22.0, 3.0 + 1.5 * 15.0, 15.0, in_way=True) == 15.0
    assert wanted_speed(22.0, 5.0, 15.0, in_way=True) < 15.0
    assert wanted_speed(22.0, 100.0, 21.0, in_way=True) == 22.0
    assert wanted_speed(22.0, 2.0, 0.0, in_way=True) == 0.0
