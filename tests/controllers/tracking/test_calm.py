"""The steering wheel in calm: it rests at the steady angle and does not hunt through the play."""

import dataclasses

import numpy as np
import pytest

from controllers.tracking.lateral_gains import CalmConfig
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap
from iits_mj.validation.planning import path_cases as cases
from iits_mj.validation.planning.path_cases import Record
from iits_mj.validation.planning.side_wind import SideWind

STEP = 2e-3
# Half the play at the steering wheel [rad].
HALF = 0.5 * TruckParameters.load().steering.dead_band


def calm_drive(payload: float) -> Record:
    """Five bends of the built-in highway and the straights between, at up to 80 km/h."""
    return cases.drive_path(
        RoadMap.builtin().route(),
        payload,
        STEP,
        cruise=80.0 / 3.6,
        duration=120.0,
        station=50.0,
        end=3050.0,
    )


@pytest.fixture(scope="module", params=[0.0, 36_000.0])
def run(request):
    return calm_drive(request.param)


def test_the_wheel_seldom_crosses_its_play_in_calm(run):
    """Without the rest there are 9 to 10 reversals a kilometre."""
    assert cases.wheel_reversals(run) < 8.0


def test_the_truck_stays_within_six_centimetres_of_its_path(run):
    assert cases.rms_error(run) < 0.027
    assert cases.peak_error(run) < 0.06


def test_a_correction_in_calm_is_little_more_than_the_play(run):
    """A reversal takes the whole play; the median one takes less than a degree more."""
    turns, wheel = [], run["wheel"]
    start, direction = wheel[0], 0.0
    last = wheel[0]
    for value in wheel:
        moved = np.sign(value - last)
        if moved and direction and moved != direction:
            turns.append(abs(last - start))
            start = last
        direction, last = moved or direction, value
    swings = np.array([turn for turn in turns if turn > HALF])
    assert len(swings) > 3
    assert np.median(swings) < 2.0 * HALF + np.deg2rad(1.0)


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_a_lane_change_stays_within_six_centimetres_of_its_path(payload):
    change = cases.lane_change(payload, STEP, 80.0 / 3.6)
    assert change["lane_changes"][-1] == 1
    assert cases.peak_error(change) < 0.06


def test_gusts_end_the_calm_and_are_corrected_at_once():
    """The greatest error is that of the controller without a rest, 0.20 m."""
    wind = SideWind.gusty(np.random.default_rng(0), 16_000.0)
    run = cases.highway(36_000.0, STEP, wind, 5200.0, 6200.0)
    assert cases.peak_error(run) < 0.21


@pytest.mark.parametrize("name", [entry.name for entry in dataclasses.fields(CalmConfig)])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_settings_of_the_calm_are_positive_and_finite(name, value):
    with pytest.raises(InputError, match=name):
        CalmConfig(**{name: value})
