"""The truck's parameter files are complete, finite and have provenance; wrong ones are refused."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import provenance


def test_every_parameter_has_a_value_a_unit_and_a_grade():
    rows = provenance()
    assert len(rows) > 150
    for name, value, unit, grade, _ in rows:
        assert unit, name
        assert grade in set("PRDLJ"), name
        assert value != "", name


def test_engine_and_gearbox_tables_are_in_si_units():
    p = TruckParameters.load()
    assert p.engine.full_load_torque.max() == 2600.0
    assert p.engine.full_load_speed[0] == pytest.approx(700 * 2 * np.pi / 60)
    assert p.engine.fuel_map.values.min() == pytest.approx(183.4e-3 / 3.6e6)
    np.testing.assert_allclose(p.gearbox.ratios[[0, 11]], [15.012, 1.0])
    assert p.gearbox.upshift.values.shape == (11, 10)
    assert (np.diff(p.air_brake.demand) > 0).all()


def test_torque_at_full_pedal_is_the_lesser_of_full_load_and_pedal_map():
    engine = TruckParameters.load().engine
    speed = np.linspace(60.0, 200.0, 30)
    full = np.interp(speed, engine.full_load_speed, engine.full_load_torque)
    asked = np.interp(speed, engine.pedal_map.rows, engine.pedal_map.values[:, -1])
    torque = engine.full_pedal_torque(speed)
    np.testing.assert_array_equal(torque, np.minimum(full, asked))
    assert (torque < 0.95 * full).any()
    assert (torque == full).any()
    # Without its own map the pedal gives the full load.
    plain = TruckParameters.load("vecto_40t").engine
    full = np.interp(speed, plain.full_load_speed, plain.full_load_torque)
    np.testing.assert_allclose(plain.full_pedal_torque(speed), full, rtol=1e-9)


def test_combination_weighs_19_t_empty_and_55_t_laden():
    p = TruckParameters.load()
    assert p.gross_mass(0) == 19_000
    assert p.gross_mass(36_000) == 55_000


def test_overlay_changes_only_what_it_names():
    overlay = {
        "engine": {"boost_lag": 0.5},
        "tires": {"steer": {"pneumatic_trail": 0.05}},
        "units": {"tractor": {"axles": {"axle2": {"damping": 20e3}}}},
    }
    base, changed = TruckParameters.load(), TruckParameters.load(overlay=overlay)
    assert changed.engine.boost_lag == 0.5
    assert changed.tires["steer"].pneumatic_trail == 0.05
    assert changed.lead.axles[1].damping == 20e3
    assert changed.lead.axles[0] == base.lead.axles[0]
    assert changed.last == base.last


@pytest.mark.parametrize(
    ("overlay", "named"),
    [
        ({"engine": {"boost": 1.0}}, "engine.boost"),
        ({"engine": {"boost_lag": "fast"}}, "boost_lag"),
        ({"engine": {"boost_lag": float("nan")}}, "boost_lag"),
        ({"gearbox": {"start_gear": 1.5}}, "start_gear"),
        ({"engine": 7}, "engine"),
        ({"units": {"tractor": {"axles": {"axle9": {"track": 2.0}}}}}, r"axles\.axle9\."),
    ],
)
def test_wrong_overlay_is_refused_and_named(overlay, named):
    with pytest.raises(InputError, match=named):
        TruckParameters.load(overlay=overlay)


@pytest.mark.parametrize(
    "content", [b"", b"not toml [", b"\xff\xfe", b"[units.tractor]\nmass = 1\n"]
)
def test_wrong_file_is_refused(tmp_path, content):
    file = tmp_path / "truck.toml"
    file.write_bytes(content)
    with pytest.raises(InputError):
        TruckParameters.load(file)


def test_missing_file_is_named():
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        TruckParameters.load("nowhere.toml")


def test_payload_height_changes_only_the_payload():
    p = TruckParameters.load()
    high = p.with_payload_height(2.8)
    assert high.last.payload.cg_height == 2.8
    assert p.with_payload_height(None) is p
    assert high.with_payload_height(p.last.payload.cg_height) == p


@pytest.mark.parametrize("height", [1.29, 3.01, float("nan"), float("inf")])
def test_payload_below_the_floor_or_above_the_roof_is_refused(height):
    with pytest.raises(InputError, match=r"payload_height = .* m: allowed is 1\.3 to 3 m"):
        TruckParameters.load().with_payload_height(height)


def test_greatest_payload_is_that_of_the_shipped_truck():
    assert TruckParameters.load().payload_max == 36_000.0
