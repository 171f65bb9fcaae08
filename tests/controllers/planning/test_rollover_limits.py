"""The rollover margin against the full roll plane, and the trailer's acceleration in a change."""

import dataclasses

import numpy as np
import pytest

from controllers.planning.lane_change import LaneChangeConfig, lateral_limit, quintic_change
from controllers.planning.rollover_limits import (
    RollMargins,
    curve_speed_by_roll,
    rearward_amplification,
    roll_threshold,
)
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling.roll_plane import RollPlane

PARAMETERS = TruckParameters.load()


@pytest.mark.parametrize(
    ("payload", "height"),
    [(0.0, None), (9e3, 2.6), (18e3, None), (36e3, 1.3), (36e3, None), (36e3, 3.0)],
)
def test_the_threshold_is_that_of_the_roll_plane_within_10_percent(payload, height):
    # The roll plane has two bodies and a fifth wheel that opens: here it is rigid.
    parameters = PARAMETERS.with_payload_height(height)
    full = RollPlane.from_parameters(parameters, payload).threshold() * GRAVITY
    assert roll_threshold(parameters, payload) == pytest.approx(full, rel=0.10)


def test_load_and_its_height_lower_the_threshold():
    by_load = [roll_threshold(PARAMETERS, load) for load in (0.0, 12e3, 24e3, 36e3)]
    heights = [PARAMETERS.with_payload_height(h) for h in (1.5, 2.0, 2.5, 3.0)]
    by_height = [roll_threshold(parameters, 36e3) for parameters in heights]
    assert by_load == sorted(by_load, reverse=True)
    assert by_height == sorted(by_height, reverse=True)


def test_a_payload_that_is_not_allowed_is_refused():
    with pytest.raises(InputError):
        roll_threshold(PARAMETERS, 50e3)


def test_slow_maneuvers_are_not_amplified_and_quick_ones_at_speed_are():
    model = LateralModel.of(PARAMETERS, 55e3, 0.1)
    assert rearward_amplification(model, 22.0, 0.01) == pytest.approx(1.0, abs=0.02)
    assert rearward_amplification(model, 25.0, 0.3) > 1.15


@pytest.mark.parametrize("mass", [19e3, 37e3, 55e3])
@pytest.mark.parametrize("speed", [12.0, 16.67, 22.2, 25.0])
def test_a_planned_change_leaves_the_trailer_its_share_of_the_threshold(mass, speed):
    config = LaneChangeConfig()
    margin = RollMargins(PARAMETERS, 1.0 / config.duration_min).at(mass)
    limit = lateral_limit(margin, speed, 0.0, config)
    change = quintic_change(0.0, 4.0, 0.0, 0.0, speed, limit, config)
    peak = trailer_peak(LateralModel.of(PARAMETERS, mass, 0.1), change, speed)
    # The polynomial is not a sine: its steeper parts are allowed 5 %.
    assert peak <= 1.05 * config.change_share * margin.threshold


def trailer_peak(model, change, speed):
    """Greatest lateral acceleration of the trailer's CG when the steer axle follows a change."""
    step = 0.005
    (coupling,), (_, behind) = model.plane.couplings, model.plane.cg
    a, _, _ = model.matrices(speed)
    state, greatest = np.zeros(4), 0.0
    for time in np.arange(0.0, change.length / speed + 4.0, step):
        wanted = float(change.evaluate(speed * time)[2]) * speed**2
        # The steer angle that gives the steer axle the wanted acceleration.
        free = a[:4, :4] @ state
        steer = (wanted - free[0] - speed * state[1]) / a[0, 6]
        rate = free + a[:4, 6] * steer
        trailer = rate[0] + speed * state[1] - coupling * rate[1] - behind * rate[2]
        greatest = max(greatest, abs(float(trailer)))
        state = state + step * rate
    return greatest


def test_cross_slope_to_the_inside_lets_the_truck_go_faster():
    curvature = np.array([1 / 100.0, 1 / 100.0, -1 / 100.0, 0.0])
    bank = np.array([-0.04, 0.04, 0.04, 0.0])
    inside, outside, inside_right, straight = curve_speed_by_roll(curvature, bank, 1.4)
    assert inside == pytest.approx(inside_right)
    assert inside > outside
    assert inside**2 / 100.0 - GRAVITY * np.tan(0.04) == pytest.approx(1.4)
    assert straight > 100.0


def test_margins_are_computed_once_for_a_mass_and_clamped_outside():
    margins = RollMargins(PARAMETERS, 0.2)
    assert margins.at(54_900.0) is margins.at(55_100.0)
    assert margins.at(70e3).threshold == margins.at(55e3).threshold
    high = dataclasses.replace(PARAMETERS).with_payload_height(3.0)
    assert RollMargins(high, 0.2).at(55e3).threshold < margins.at(55e3).threshold


def with_load_height(truck, unit, height):
    """The truck with the load of one unit at another height [m]."""
    units = list(truck.units)
    load = dataclasses.replace(units[unit].payload, cg_height=height)
    units[unit] = dataclasses.replace(units[unit], payload=load)
    return dataclasses.replace(truck, units=tuple(units))


def test_a_drawbar_leaves_the_weaker_of_two_vehicles_to_roll_over_alone():
    truck = TruckParameters.load("rigid_drawbar")
    full = truck.payload_max
    heights = (1.5, 1.5), (2.6, 1.5), (1.5, 2.4), (2.6, 2.4)
    low, first, second, both = (
        roll_threshold(with_load_height(with_load_height(truck, 0, a), 1, b), full)
        for a, b in heights
    )
    assert max(first, second) < low
    # Neither vehicle holds the other: drawbar loads are small.
    assert both == pytest.approx(min(first, second), rel=0.02)


def test_units_on_fifth_wheels_roll_over_together():
    truck = TruckParameters.load("b_double")
    full, height = truck.payload_max, truck.units[2].payload.cg_height
    raised = [with_load_height(truck, unit, height + 0.4) for unit in (1, 2)]
    both = with_load_height(raised[0], 2, height + 0.4)
    base, *one = (roll_threshold(p, full) for p in (truck, *raised))
    assert roll_threshold(both, full) < min(one) < max(one) < base


def test_more_joints_amplify_more():
    def amplification(name):
        truck = TruckParameters.load(name)
        model = LateralModel.of(truck, truck.gross_mass(truck.payload_max), 0.1)
        return rearward_amplification(model, 22.2, 0.4)

    names = "vecto_tractor", "vecto_40t", "b_double", "a_double"
    gains = [amplification(name) for name in names]
    assert gains[0] == 1.0
    assert gains == sorted(gains)
    # Winkler and others (FHWA-RD-00-078): A-doubles reach about twice the tractor's acceleration.
    assert gains[-1] > 1.7
