import numpy as np
import pytest

from iits_mj.analytic import (
    axle_cornering_stiffness,
    cruise_axle_loads,
    laden_units,
    static_axle_loads,
    understeer_gradient_by_loads,
)
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tire_law import (
    cornering_stiffness,
    friction,
    lateral_shape,
    nominal_cornering_coefficient,
)

PARAMETERS = TruckParameters.load()


@pytest.mark.parametrize(
    ("payload", "published"),
    [
        (36_000.0, [60.7, 94.9, 94.9, 96.4, 96.4, 96.4]),
        (0.0, [50.6, 34.6, 34.6, 22.2, 22.2, 22.2]),
    ],
)
def test_axle_loads_agree_with_the_published_figures(payload, published):
    loads = static_axle_loads(PARAMETERS, payload)
    np.testing.assert_allclose(loads / 1e3, published, rtol=0.005)


@pytest.mark.parametrize("payload", [0.0, 12_345.0, 36_000.0])
def test_axle_loads_carry_the_whole_weight(payload):
    weight = PARAMETERS.gross_mass(payload) * GRAVITY
    assert static_axle_loads(PARAMETERS, payload).sum() == pytest.approx(weight, rel=1e-12)


def test_laden_trailer_has_the_published_mass_cg_and_inertia():
    trailer = laden_units(PARAMETERS, 36_000.0)[1]
    assert trailer.mass == pytest.approx(46_100.0)
    assert trailer.cg_position == pytest.approx(5.05, abs=1e-3)
    assert trailer.cg_height == pytest.approx(2.05, abs=1e-3)
    assert trailer.inertia_z == pytest.approx(683_000.0, rel=1e-3)


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_cruising_unloads_the_steer_axle_and_keeps_the_weight(payload):
    rest = static_axle_loads(PARAMETERS, payload)
    cruise = cruise_axle_loads(PARAMETERS, payload, 22.0)
    assert cruise.sum() == pytest.approx(rest.sum(), rel=1e-12)
    assert 0.0 < rest[0] - cruise[0] < 0.05 * rest[0]
    assert cruise[1] > rest[1]
    slow = cruise_axle_loads(PARAMETERS, payload, 0.1)
    np.testing.assert_allclose(slow, rest, rtol=0.02)


@pytest.mark.parametrize("payload", [-1.0, 36_000.1, float("nan")])
def test_impossible_payload_is_refused(payload):
    with pytest.raises(InputError, match="payload"):
        static_axle_loads(PARAMETERS, payload)


def test_cornering_stiffness_at_its_own_load_is_the_coefficient_times_the_load():
    common = PARAMETERS.tire_common
    for tire in PARAMETERS.tires.values():
        expected = tire.cornering_coefficient * tire.cornering_load
        assert cornering_stiffness(tire.cornering_load, tire, common) == pytest.approx(expected)


def test_plugin_gets_the_coefficient_at_nominal_load():
    common = PARAMETERS.tire_common
    for tire in PARAMETERS.tires.values():
        stiffness = nominal_cornering_coefficient(tire, common) * common.nominal_load
        assert cornering_stiffness(common.nominal_load, tire, common) == pytest.approx(stiffness)


def test_coefficients_hold_at_the_laden_axle_loads_and_give_the_intended_understeer():
    loads = static_axle_loads(PARAMETERS, 36_000.0)
    for axle, load in zip(PARAMETERS.axles, loads, strict=True):
        tire = PARAMETERS.tires[axle.tire]
        assert load / (2 * tire.count) == pytest.approx(tire.cornering_load, rel=0.005)
    gradient = understeer_gradient_by_loads(PARAMETERS, 36_000.0)
    assert np.rad2deg(gradient) * GRAVITY == pytest.approx(1.6, abs=0.05)


def test_cornering_stiffness_grows_less_than_the_load_and_vanishes_with_it():
    common, tire = PARAMETERS.tire_common, PARAMETERS.tires["steer"]
    load = np.linspace(1e3, common.load_saturation * common.nominal_load, 50)
    per_load = cornering_stiffness(load, tire, common) / load
    assert np.all(np.diff(per_load) < 0.0)
    assert cornering_stiffness(0.0, tire, common) == 0.0
    assert cornering_stiffness(-5.0, tire, common) == 0.0


def test_friction_falls_with_load():
    common = PARAMETERS.tire_common
    assert friction(common.nominal_load, 0.82, common) == pytest.approx(0.82)
    assert friction(2.0 * common.nominal_load, 0.82, common) == pytest.approx(0.82 * 0.92)


def test_axle_stiffness_counts_every_tire():
    loads = np.full(6, 4.0 * PARAMETERS.tires["drive"].cornering_load)
    stiffness = axle_cornering_stiffness(PARAMETERS, loads)
    nominal = PARAMETERS.tires["drive"].cornering_coefficient * loads[1]
    assert stiffness[1] == pytest.approx(nominal)


def test_side_force_over_its_peak_starts_with_the_shape_and_peaks_at_one():
    common = PARAMETERS.tire_common
    assert lateral_shape(1e-6, common) / 1e-6 == pytest.approx(common.shape_lateral)
    stretch = np.linspace(0.0, 20.0, 2001)
    assert np.max(lateral_shape(stretch, common)) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(lateral_shape(-stretch, common), -lateral_shape(stretch, common))
