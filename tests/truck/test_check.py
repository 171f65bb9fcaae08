"""Inspection of trucks: loads, usual limits, contradictions, rest."""

import math
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.truck.check import inspect_truck, legal_load, load_warnings, resting_loads


def written(folder: Path, text: str) -> Path:
    path = folder / "truck.toml"
    path.write_text('extends = "vecto_40t"\n' + text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_shipped_truck_rests_on_its_static_loads(name):
    found = inspect_truck(name)
    assert not [text for text in found.warnings if "at rest" in text or "stand still" in text]
    assert not [text for text in found.warnings if "without unit" in text]
    assert name in found.to_text() or dict(found.summary)["truck"] in found.to_text()


def test_axle_loads_at_rest_carry_the_whole_truck():
    truck = TruckParameters.load("b_double")
    loads, speed = resting_loads(truck, 10_000.0)
    assert loads.sum() == pytest.approx(truck.gross_mass(10_000.0) * 9.81, rel=1e-4)
    np.testing.assert_allclose(loads, static_axle_loads(truck, 10_000.0), rtol=0.005)
    assert abs(speed) < 1e-3


def test_summary_has_masses_loads_and_length():
    rows = dict(inspect_truck("vecto_40t").summary)
    assert rows["mass laden"] == "40.00 t"
    assert rows["length"] == "16.45 m"
    assert rows["axle loads laden [kN]"] == "68.7 108.0 | 71.9 71.9 71.9"
    assert "350 kW" in rows["engine"]


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        ("[units.tractor]\nmass = 7000.0", "without unit or grade: units.tractor.mass"),
        ("[tires.steer]\nrolling_radius = 0.55", "tires.steer.rolling_radius = 0.55 m is greater"),
        ("[tires.spare]\nlike = 'steer'", "tires.spare is on no axle"),
        ("[tires.drive]\nvertical_stiffness = 2e5", "tires.drive is compressed by"),
        ("[gearbox]\nfinal_drive = 5.18", "governed at 73 km/h in the highest gear"),
        ("[gearbox]\nefficiency = 0.5\ngears = 'gears.csv'", "gearbox.efficiency = 0.5"),
        (
            "[gearbox]\ngears = 'gears.csv'\nshift_strategy = 'tables'",
            "gearbox.upshift is not given",
        ),
        ("[engine]\nfull_load = 'load.csv'", "the full load at torque 2600 N m"),
        ("[units.trailer.payload]\nmass_max = 40000", "96/53/EC allows 11.5 t"),
        ("[units.trailer.payload]\ncg_position = 9.0", "loads its coupling with -"),
        (
            "[units.trailer.coupling]\nposition = 4.9",
            "of the motor vehicle's load; 20 % are needed",
        ),
        ("[units.tractor.axles.axle2]\nlifted_below = 0.0", "engine.pedal_map is not given"),
    ],
)
def test_contradictions_are_named(text, warning, tmp_path):
    (tmp_path / "gears.csv").write_text("gear,ratio\n1,14.9\n2,5.0\n3,1.0\n")
    (tmp_path / "load.csv").write_text("rpm,torque_Nm\n600,1500\n1100,2600\n1900,1700\n")
    assert warning in "\n".join(inspect_truck(written(tmp_path, text)).warnings)


def test_lifted_axles_are_named_only_while_they_are_lifted():
    texts = load_warnings(TruckParameters.load("tractor_semitrailer_6x2"))
    lifted = [text for text in texts if "is lifted" in text]
    assert lifted == ["empty: tractor_axle3 is lifted, up to a payload of 12000 kg"]


def test_limits_are_those_of_the_directive():
    trucks = {name: TruckParameters.load(name) for name in shipped_trucks()}
    vecto = trucks["vecto_40t"]
    front, rear = vecto.lead.groups(0.0)
    assert legal_load(vecto.lead, front) == 10.0
    assert legal_load(vecto.lead, rear) == 11.5
    assert legal_load(vecto.last, vecto.last.axles) == 24.0  # 1.31 m apart
    standard = trucks["tractor_semitrailer_6x4"]
    assert legal_load(standard.lead, standard.lead.groups(0.0)[1]) == 19.0
    rigid = trucks["rigid_drawbar"]
    assert legal_load(rigid.last, rigid.last.axles) == 18.0
    assert math.isinf(legal_load(rigid.lead, rigid.lead.axles * 2)) is False


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[units.tractor]\nmas = 7", "units.tractor.mas is unknown (did you mean mass?)"),
        ("[units.tractor]\nmass = -7", "units.tractor.mass = -7 kg: allowed is 1 to 1e+06 kg"),
        (
            "[units.tractor]\nmass = { value = 7, unit = 'm' }",
            "units.tractor.mass: unit 'm' is not one of 'kg', 't'",
        ),
        ("[engine]\nfull_load = 'nothing.csv'", "nothing.csv"),
        ("[units.trailer]\nkind = 'wagon'", "units.trailer: kind"),
        ("[units.tractor]\nmass = 100.0", "body 'tractor' would have a mass of -"),
        ("[units.tractor]\ncg_position = -3.0", "body 'tractor' would have a mass of"),
        ("[units.trailer]\ninertia_x = 0.0", "body 'trailer' would have"),
        (
            "[units.tractor.axles.axle2]\nunsprung_mass = 50.0",
            "body 'tractor_axle2' would have a mass of -330 kg",
        ),
        ("[gearbox]\nfinal_drive = 0.0", "gearbox.final_drive = 0: allowed is 0.1 to 100"),
        ("[tires.drive]\nrolling_radius = 0.0", "rolling_radius = 0 m: allowed is 0.1 to 2 m"),
        ("[units.trailer.payload]\nmass_max = 0.0", "mass_max = 0 kg: allowed is 1 to"),
        ("[units.tractor.axles.axle2]\nlifted_below = 1e4", "lifts a whole group"),
        ("[units.'*']\nair_share = 0.0", "air_share have no positive sum"),
        ("[engine]\nfull_load = 'zero.csv'", "no torque and speed are above zero"),
    ],
)
def test_errors_name_file_key_value_and_what_is_allowed(text, reason, tmp_path):
    (tmp_path / "zero.csv").write_text("rpm,torque_Nm\n600,0\n1900,0\n")
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        inspect_truck(path)
    assert reason in str(error.value)
    assert str(path) in str(error.value)
