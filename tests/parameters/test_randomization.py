"""Trucks drawn from the uncertainty of the parameters: bounds, seeds, wrong files."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.parameters.randomization import Quantity, Spread


def test_the_same_generator_draws_the_same_truck():
    spread = Spread.load()
    one, again, other = (spread.draw(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == again
    assert one.factors != other.factors


def test_factors_stay_within_their_bounds_and_reach_them():
    spread = Spread.load()
    generator = np.random.default_rng(0)
    drawn = [spread.draw(generator).factors for _ in range(400)]
    for quantity in spread.quantities:
        factors = np.array([factors[quantity.name] for factors in drawn])
        width = quantity.high - quantity.low
        assert quantity.low <= factors.min() < quantity.low + 0.05 * width
        assert quantity.high - 0.05 * width < factors.max() <= quantity.high


def test_parameters_of_a_drawn_truck_are_the_shipped_ones_times_the_factors():
    spread, shipped = Spread.load(), TruckParameters.load()
    for seed in range(20):
        drawn = spread.draw(np.random.default_rng(seed))
        truck = TruckParameters.load(overlay=drawn.overlay)
        factor = drawn.factors["trailer_springs"]
        for ours, theirs in zip(truck.units[1].axles, shipped.units[1].axles, strict=True):
            assert ours.spring_rate == pytest.approx(factor * theirs.spring_rate)
            assert ours.position == theirs.position
        np.testing.assert_allclose(
            truck.engine.full_load_torque,
            drawn.factors["engine_torque"] * np.asarray(shipped.engine.full_load_torque),
        )
        assert truck.lead.mass == shipped.lead.mass


def test_the_nominal_truck_is_the_shipped_one():
    drawn = Spread.load().nominal()
    assert set(drawn.factors.values()) == {1.0}
    assert drawn.overlay == {}


@pytest.fixture
def tractor(tmp_path):
    """File of a tractor without trailer, whose engine has another power."""
    file = tmp_path / "truck.toml"
    file.write_text(
        'extends = "tractor_semitrailer_6x4"\nremove = ["units.trailer"]\n'
        '[engine]\npower = { value = 300, unit = "kW" }\n'
        '[steering]\nstiffness = { value = 30, unit = "kN m/rad" }\n'
    )
    return file


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_shipped_truck_can_be_drawn(name):
    spread, shipped = Spread.load(truck=name), TruckParameters.load(name)
    drawn = spread.draw(np.random.default_rng(3))
    truck = TruckParameters.load(name, overlay=drawn.overlay)
    for ours, theirs in zip(truck.axles, shipped.axles, strict=True):
        brake, original = ours.brake, theirs.brake
        factor = drawn.factors["brake_torque"]
        assert brake.torque_per_pressure == pytest.approx(factor * original.torque_per_pressure)
        assert brake.chamber_volume == original.chamber_volume
    np.testing.assert_allclose(
        truck.engine.full_load_torque,
        drawn.factors["engine_torque"] * shipped.engine.full_load_torque,
    )


def test_what_a_truck_lacks_is_left_out_and_the_factors_stay_the_same(tractor):
    whole, alone = Spread.load(), Spread.load(truck=tractor)
    drawn = alone.draw(np.random.default_rng(5))
    assert drawn.factors == whole.draw(np.random.default_rng(5)).factors
    assert set(drawn.overlay["units"]) == {"tractor"}
    shipped, truck = TruckParameters.load(tractor), TruckParameters.load(tractor, drawn.overlay)
    assert [unit.name for unit in truck.units] == ["tractor"]
    factor = drawn.factors["tractor_springs"]
    assert truck.axles[2].spring_rate == pytest.approx(factor * shipped.axles[2].spring_rate)
    factor = drawn.factors["engine_torque"]
    assert truck.engine.full_load_power == pytest.approx(factor * 300e3)
    assert truck.engine.inertia == pytest.approx(shipped.engine.inertia)
    factor = drawn.factors["steering_stiffness"]
    assert truck.steering.stiffness == pytest.approx(factor * 30e3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            '[a]\nparameters = ["units.dolly.axels.*.track"]\nlow = 1\nhigh = 1',
            "axels.*no such parameter",
        ),
        (
            '[a]\nparameters = ["units.*.axles.*.brake.x"]\nlow = 1\nhigh = 1',
            "brake.x: there is no such",
        ),
        ('[a]\nparameters = ["units.tractor"]\nlow = 1\nhigh = 1', "is not a number"),
        ('[a]\nparameters = ["units.tractor.kind"]\nlow = 1\nhigh = 1', "is not a number"),
        ('[a]\nparameters = ["units.*.axles.*.driven"]\nlow = 1\nhigh = 1', "is not a number"),
        ('[a]\nparameters = ["engine.pedal_map"]\nlow = 1\nhigh = 1', "is not a number"),
        (
            '[a]\nparameters = ["tires.steer.count", "tires.*.count"]\nlow = 1\nhigh = 1',
            "drawn already",
        ),
        ('[a]\nparameters = ["tires.steer.width"]\nlow = 1\nhigh = 1', "tires.steer.width"),
        ('[a]\nparameters = ["gearbox.shift_strategy"]\nlow = 1\nhigh = 1', "is not a number"),
        ('[a]\nparameters = ["units.tractor.mass"]\nlow = 2\nhigh = 1', "low first"),
        ('[a]\nparameters = ["units.tractor.mass"]\nlow = 1\nhigh = inf', "finite"),
        ('[a]\nparameters = ["units.tractor.mass"]\nlow = 1', "missing"),
        ('[a]\nparameters = ["units.tractor.mass"]\nlow = 1\nhigh = 1\nsigma = 1', "unknown"),
        ("[a]\nparameters = []\nlow = 1\nhigh = 1", "at least one"),
        ("a = 1", "not a table"),
        (
            '[a]\nparameters = ["units.tractor.mass", "units.tractor.mass"]\nlow = 1\nhigh = 1',
            "drawn already",
        ),
    ],
)
def test_unusable_spreads_are_refused(tmp_path, content, message):
    file = tmp_path / "spread.toml"
    file.write_text(content)
    with pytest.raises(InputError, match=message):
        Spread.load(file)


def test_a_user_defined_spread_scales_its_parameter():
    spread = Spread((Quantity("friction", ("tire_common.friction_lateral",), 0.5, 0.5),))
    drawn = spread.draw(np.random.default_rng(0))
    assert drawn.overlay == {"tire_common": {"friction_lateral": pytest.approx(0.41)}}
