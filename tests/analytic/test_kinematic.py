import numpy as np
import pytest

from iits_mj.analytic import Kinematic
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters

MODEL = Kinematic.from_parameters(TruckParameters.load())


def test_hitch_lies_ahead_of_the_drive_axles():
    assert pytest.approx(3.9) == MODEL.L
    assert pytest.approx(-0.3) == MODEL.hitches[0]
    assert pytest.approx(7.9) == MODEL.lengths[0]


def _drive(steer, length, speed=1.0):
    time = np.linspace(0.0, length / abs(speed), 2001)
    ones = np.ones_like(time)
    return time, MODEL.simulate(time, speed * ones, steer * ones)


def test_steady_turn_has_the_pythagorean_off_tracking():
    steer = np.arctan(MODEL.L / 20.0)
    _, states = _drive(steer, 250.0)
    center = np.array([0.0, 20.0])
    front = np.linalg.norm(MODEL.steer_axle(states)[-1] - center)
    rear = np.linalg.norm(MODEL.trailer_axle(states)[-1] - center)
    assert rear - front == pytest.approx(MODEL.off_tracking(front), abs=1e-3)


def test_wheels_do_not_slip_sideways():
    _, states = _drive(0.2, 60.0)
    rear = MODEL.trailer_axle(states)
    heading = states[:, 2] + states[:, 4]
    velocity = np.gradient(rear, axis=0)[1:-1]
    across = -velocity[:, 0] * np.sin(heading[1:-1]) + velocity[:, 1] * np.cos(heading[1:-1])
    assert np.abs(across).max() < 1e-4 * np.abs(velocity).max()


def test_reversing_with_an_articulation_jack_knifes():
    time = np.linspace(0.0, 15.0, 1501)
    speed = np.where(time < 5.0, 1.0, -1.0)
    steer = np.where(time < 5.0, 0.1, 0.0)
    states = MODEL.simulate(time, speed, steer)
    assert abs(states[-1, 4]) > 2.0 * abs(states[500, 4]) > 0.0


def test_too_small_a_circle_is_refused():
    with pytest.raises(InputError, match="radius"):
        MODEL.off_tracking(5.0)
