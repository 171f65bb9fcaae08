"""A winding drive shows the air drag and the tires, in spite of the drag and the slope of bends."""

import numpy as np
import pytest

from iits_mj.identification import identify
from iits_mj.identification.log import with_grade
from iits_mj.parameters import TruckParameters
from tests.identification.synthetic_drives import Driver, drive, random_road, table
from tests.identification.truck_drives import hidden_truck

pytestmark = pytest.mark.slow
PARAMETERS = TruckParameters.load()
PAYLOAD = 20_000.0
MASS = PARAMETERS.gross_mass(PAYLOAD)
HIDDEN = {
    "aerodynamics": {"drag_area": 7.3},
    "tires": {"drive": {"cornering_coefficient": 5.2}},
}


@pytest.fixture(scope="module")
def log():
    """Telemetry of nine minutes on bends that lean inward, with noise of 0.4 % on the speed."""
    rng = np.random.default_rng(4)
    road = random_road(rng, 11_000.0, winding=True)
    truck = hidden_truck(PAYLOAD, HIDDEN, road, station=80.0, speed=15.0)
    rows = drive(truck, Driver(rng, road, PARAMETERS, weave=0.1), 540.0)
    station = np.arange(0.0, rows[-1][0].station + 100.0, 12.5)
    log = table(rows, noise=0.004, yaw_noise=0.002)
    return with_grade(log, station, np.asarray(road.smoothed_grade(station)))


def test_drag_area_comes_back_on_bends(log):
    found = identify(log, PARAMETERS, mass=MASS, groups=("motion",))["drag_area"]
    assert found.identifiable, found.reason
    assert abs(found.value - 7.3) < found.half_width
    assert found.half_width < 0.12 * 7.3


def test_without_a_yaw_rate_the_drag_of_bends_is_not_told_from_other_drag(log):
    blind = log.only([name for name in log.signals if name != "yaw_rate"])
    right = identify(log, PARAMETERS, mass=MASS, groups=("motion",))
    wrong = identify(blind, PARAMETERS, mass=MASS, groups=("motion",))
    assert wrong["drag_area"].half_width > 1.5 * right["drag_area"].half_width
    assert not any(e.name == "cornering_drag_scale" for e in right.estimates)


def test_tires_come_back_on_bends_that_lean(log):
    found = identify(log, PARAMETERS, mass=MASS, groups=("steering",))
    for kind, truth in (("steer", 5.0), ("drive", 5.2), ("trailer", 5.8)):
        estimate = found[f"cornering_coefficient_{kind}"]
        assert estimate.identifiable, estimate.reason
        assert abs(estimate.value - truth) < estimate.half_width
    assert not any(e.name == "coupling_friction" for e in found.estimates)
