"""A maneuver that the truck itself "measured" is repeated, one of another truck is not."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.validation import ValidateConfig
from iits_mj.validation.harness import recorder
from iits_mj.validation.harness.maneuver import steady_truck
from iits_mj.validation.harness.rating import rate
from iits_mj.validation.measured import read_maneuver, run, simulate

PARAMETERS = TruckParameters.load()
PAYLOAD, SPEED, TIMESTEP = 20_000.0, 18.0, 0.005
DEGREE = 180.0 / np.pi
TITLES = ("time [s]", "speed [km/h]", "steering_wheel_angle [deg]", "yaw_rate [deg/s]")
TITLES += ("lateral_acceleration [g]", "articulation [rad]")


@pytest.fixture(scope="module")
def columns():
    """A single sine of the steering wheel, in the units of `TITLES`."""
    truck, hold = steady_truck(PAYLOAD, SPEED, TIMESTEP)
    record = recorder.drive(
        truck,
        lambda now, yaw: 0.8 * np.sin(2.0 * np.pi * (now - 1.0) / 3.0) * (1.0 < now < 4.0),
        speed=SPEED,
        duration=8.0,
        hold=hold,
    )
    return [
        record.time + 12.0,
        record.speed * 3.6,
        record.steering_wheel * DEGREE,
        record.yaw_rate * DEGREE,
        record.lateral_acceleration / 9.81,
        record.articulation,
    ]


def write(path, columns, titles=TITLES):
    cells = zip(*columns, strict=True)
    rows = [",".join(titles), *(",".join(f"{x:.9g}" for x in row) for row in cells)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_the_truck_repeats_its_own_maneuver(columns, tmp_path):
    log = read_maneuver(write(tmp_path / "sine.csv", columns))
    found = simulate(log, PARAMETERS, PAYLOAD, TIMESTEP)
    assert set(found) == {"yaw_rate", "lateral_acceleration", "articulation"}
    for name, values in found.items():
        assert rate(values, log[name]).overall > 0.97, name


def test_a_truck_with_soft_trailer_tires_does_not(columns, tmp_path):
    log = read_maneuver(write(tmp_path / "sine.csv", columns))
    soft = TruckParameters.load(overlay={"tires": {"trailer": {"cornering_coefficient": 3.5}}})
    right = rate(simulate(log, PARAMETERS, PAYLOAD, TIMESTEP)["articulation"], log["articulation"])
    wrong = rate(simulate(log, soft, PAYLOAD, TIMESTEP)["articulation"], log["articulation"])
    assert wrong.overall < right.overall - 0.1


@pytest.mark.slow
def test_the_report_has_ratings_and_an_envelope_around_the_measurement(columns, tmp_path):
    path = write(tmp_path / "sine.csv", columns)
    config = ValidateConfig(measured=path, payload=PAYLOAD, timestep=TIMESTEP, quick=True)
    report = run(config)
    values = {check.name: check.value for check in report.checks}
    assert values["sine: yaw rate: rating by ISO/TS 18571"] > 0.97
    assert values["sine: articulation: measurement inside the envelope"] > 80.0
    panels = report.figures["measured"]
    assert panels[0].title == "sine: yaw rate"
    measured, _, low, high = panels[0].lines
    assert np.all(low.y <= high.y)
    assert len(measured.x) == len(columns[0])


def changed(columns, index, row, value):
    own = [column.copy() for column in columns]
    own[index][row] = value
    return own


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: (c[:2] + c[3:], TITLES[:2] + TITLES[3:]), "lacks steering_wheel_angle"),
        (lambda c: (c[:3], TITLES[:3]), "none of yaw_rate, lateral_acceleration, articulation"),
        (lambda c: (changed(c, 3, 40, np.nan), TITLES), "'yaw_rate' .* not finite"),
        (lambda c: (changed(c, 0, 40, 12.0), TITLES), "time .* must increase"),
        (lambda c: (c, ("time [s]", "speed [mph]", *TITLES[2:])), "'mph'; use m/s or km/h"),
        (lambda c: (c, (*TITLES[:3], "yaw_rate [deg]", *TITLES[4:])), "'deg'; use rad/s"),
        (lambda c: (changed(c, 1, 40, 0.0), TITLES), "speeds of 0 to"),
        (lambda c: ([x[:30] for x in c], TITLES), "30 rows"),
    ],
)
def test_a_wrong_table_gets_one_clear_error(columns, tmp_path, change, match):
    with pytest.raises(InputError, match=match):
        read_maneuver(write(tmp_path / "wrong.csv", *change(columns)))


def test_the_group_needs_a_file():
    with pytest.raises(InputError, match="--measured"):
        run(ValidateConfig())
