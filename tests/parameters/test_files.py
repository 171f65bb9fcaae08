"""Truck files: what they extend, remove and copy, their units and tables, and their errors."""

import shutil

import numpy as np
import pytest

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks, truck_file
from iits_mj.parameters.files import provenance, ungraded

BASE = "tractor_semitrailer_6x4"
RPM = np.pi / 30.0


@pytest.fixture(scope="module")
def shipped():
    return TruckParameters.load()


@pytest.fixture
def write(tmp_path):
    """Writes a truck's file that extends the shipped one; returns its path."""

    def written(text, name="own", extends=f'extends = "{BASE}"\n', **tables):
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for table, content in tables.items():
            (folder / f"{table}.csv").write_text(content)
        file = folder / "truck.toml"
        file.write_text(extends + text)
        return file

    return written


def refused(overlay, *words, truck=None):
    """Checks that an overlay is refused with an error that contains all words."""
    with pytest.raises(InputError) as error:
        TruckParameters.load(truck, overlay=overlay)
    for word in words:
        assert word in str(error.value), (word, str(error.value))


# --- names and files ------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_shipped_truck_loads_and_every_quantity_of_it_has_a_unit_and_a_grade(name):
    truck = TruckParameters.load(name)
    assert truck.name == name
    assert not ungraded(name)
    assert all(row[1] for row in provenance(name))


def test_a_shipped_truck_is_not_changed_by_who_loaded_it_before():
    first = TruckParameters.load()
    first.tires["steer"] = first.tires["drive"]
    first.engine.full_load_torque[:] = 0.0
    again = TruckParameters.load()
    assert again.tires["steer"] != again.tires["drive"]
    assert again.engine.full_load_torque.max() > 1000.0
    assert TruckParameters.load(overlay={"engine": {"boost_lag": 0.5}}).engine.boost_lag == 0.5
    assert TruckParameters.load().digest() == again.digest()


@pytest.mark.parametrize("name", [BASE, "a_double"])
def test_a_shipped_file_that_changes_is_read_again(name, monkeypatch, tmp_path):
    shutil.copytree(mjcf_dir() / "trucks", tmp_path / "trucks")
    monkeypatch.setattr("iits_mj.parameters.files.mjcf_dir", lambda: tmp_path)
    before = TruckParameters.load(name)
    file = tmp_path / "trucks" / BASE / "truck.toml"
    file.write_text(
        file.read_text().replace("\nratio = { value = 21.0", "\nratio = { value = 21.5")
    )
    assert (before.steering.ratio, TruckParameters.load(name).steering.ratio) == (21.0, 21.5)


def test_shipped_trucks_that_extend_each_other_are_refused(monkeypatch, tmp_path):
    shutil.copytree(mjcf_dir() / "trucks", tmp_path / "trucks")
    monkeypatch.setattr("iits_mj.parameters.files.mjcf_dir", lambda: tmp_path)
    file = tmp_path / "trucks" / BASE / "truck.toml"
    file.write_text('extends = "b_double"\n' + file.read_text())
    with pytest.raises(InputError, match="extend each other without end"):
        TruckParameters.load("b_double")


def test_a_truck_is_given_by_its_name_its_folder_or_its_file(shipped, monkeypatch, tmp_path):
    file = truck_file(BASE)
    assert TruckParameters.load(file).units == shipped.units
    assert TruckParameters.load(file.parent).units == shipped.units
    monkeypatch.chdir(tmp_path)
    assert TruckParameters.load(BASE).units == shipped.units


def test_an_unknown_truck_is_refused_with_the_names_of_the_shipped_ones():
    with pytest.raises(InputError, match=f"'nothing' is neither.*{BASE}"):
        TruckParameters.load("nothing")


# --- extends, remove, like, * ---------------------------------------------------------------


def test_a_file_changes_only_what_it_names_of_the_truck_that_it_extends(write, shipped):
    truck = TruckParameters.load(write("[engine]\nboost_lag = 0.9\n"))
    assert truck.name == "own"
    assert truck.engine.boost_lag == 0.9
    assert truck.units == shipped.units
    assert truck.engine.idle_gain == shipped.engine.idle_gain


def test_files_extend_files_by_paths_relative_to_themselves(write, monkeypatch, tmp_path):
    write("[engine]\nboost_lag = 0.9\n[steering]\nratio = 21.0\n", name="first")
    second = write("[engine]\nboost_lag = 1.1\n", name="second", extends='extends = "../first"\n')
    monkeypatch.chdir(tmp_path)
    truck = TruckParameters.load(second)
    assert truck.engine.boost_lag == 1.1
    assert truck.steering.ratio == 21.0


def test_files_that_extend_each_other_are_refused_with_their_chain(write):
    one = write("", name="one", extends='extends = "../two"\n')
    write("", name="two", extends='extends = "../one"\n')
    with pytest.raises(InputError, match=r"without end: .*one.*two.*one"):
        TruckParameters.load(one)


def test_extends_needs_a_name(write):
    with pytest.raises(InputError, match=r"extends = 5: a name or path is needed"):
        TruckParameters.load(write("", extends="extends = 5\n"))
    with pytest.raises(InputError, match="'elsewhere' is neither"):
        TruckParameters.load(write("", extends='extends = "elsewhere"\n'))


def test_removed_parts_are_gone(shipped):
    names = ["units.trailer", "units.tractor.axles.axle3"]
    truck = TruckParameters.load(overlay={"remove": names})
    assert [unit.name for unit in truck.units] == ["tractor"]
    assert truck.lead.axles == shipped.lead.axles[:2]
    assert truck.payload_max == 0.0


def test_removing_from_every_table_takes_a_star(shipped):
    names = {"remove": ["units.*.axles.axle3", "units.*.payload"]}
    refused(names, "remove 'units.*.payload'", "no 'payload'", "'axles'")
    truck = TruckParameters.load(overlay={"remove": ["units.*.axles.axle3"]})
    assert [len(unit.axles) for unit in truck.units] == [2, 2]
    assert truck.last.axles[0] == shipped.last.axles[0]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("units.dolly", ("remove 'units.dolly'", "no 'dolly'", "'tractor'", "'trailer'")),
        ("units.trailer.mass.value.x", ("remove 'units.trailer.mass", "no table")),
    ],
)
def test_only_what_is_there_can_be_removed(name, words):
    refused({"remove": [name]}, *words)


def test_remove_needs_a_list():
    refused({"remove": "units.trailer"}, "remove = 'units.trailer'", "a list")


def test_a_like_table_has_its_siblings_values_and_its_own(shipped):
    axle = {"like": "axle3", "position": 10.4, "brake": {"dead_time": 0.2}}
    truck = TruckParameters.load(overlay={"units": {"trailer": {"axles": {"axle4": axle}}}})
    third, fourth = truck.last.axles[2:]
    assert third == shipped.last.axles[2]
    assert fourth.name == "trailer_axle4"
    assert fourth.position == 10.4
    assert fourth.brake.dead_time == 0.2
    assert fourth.brake.chamber_volume == third.brake.chamber_volume
    assert fourth.spring_rate == third.spring_rate


def test_a_like_unit_has_axles_and_coupling_of_its_own(shipped):
    truck = TruckParameters.load(overlay={"units": {"second": {"like": "trailer"}}})
    first, second = truck.units[1:]
    assert [axle.name for axle in second.axles] == [f"second_axle{i}" for i in (1, 2, 3)]
    assert [axle.position for axle in second.axles] == [axle.position for axle in first.axles]
    assert second.coupling == first.coupling
    assert truck.coupling_names == ("fifth_wheel", "second_fifth_wheel")
    assert truck.payload_max == 2.0 * shipped.payload_max


@pytest.mark.parametrize("sibling", ["axle9", "position", 3])
def test_like_names_a_table_before(sibling):
    overlay = {"units": {"trailer": {"axles": {"axle4": {"like": sibling}}}}}
    refused(overlay, "units.trailer.axles.axle4.like", repr(sibling), "'axle1', 'axle2', 'axle3'")


def test_a_star_changes_every_table_at_its_place(shipped):
    overlay = {
        "units": {"*": {"axles": {"*": {"brake": {"dead_time": 0.3}}}}},
        "tires": {"*": {"rolling_resistance": 0.004}},
    }
    truck = TruckParameters.load(overlay=overlay)
    assert {axle.brake.dead_time for axle in truck.axles} == {0.3}
    assert {tire.rolling_resistance for tire in truck.tires.values()} == {0.004}
    assert truck.lead.mass == shipped.lead.mass


def test_a_star_without_tables_is_refused():
    refused({"steering": {"*": {"ratio": 20.0}}}, "parameter steering.*", "no table")


# --- towing order ---------------------------------------------------------------------------


def test_units_are_in_towing_order_whatever_their_order_in_the_file(shipped):
    middle = {"like": "trailer", "behind": "tractor"}
    overlay = {"units": {"lead_trailer": middle, "trailer": {"behind": "lead_trailer"}}}
    truck = TruckParameters.load(overlay=overlay)
    assert [unit.name for unit in truck.units] == ["tractor", "lead_trailer", "trailer"]
    assert truck.last == shipped.last


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ({"trailer": {"behind": "bus"}}, ("units.trailer.behind = 'bus'", "'tractor'")),
        ({"second": {"like": "trailer", "behind": "tractor"}}, ("units.second.behind", "tows no")),
        ({"trailer": {"behind": "trailer"}}, ("'trailer'", "not coupled")),
        ({"second": 7}, ("units.second = 7", "a table")),
    ],
)
def test_units_that_are_no_chain_are_refused(units, words):
    refused({"units": units}, *words)


def test_two_motor_vehicles_are_refused():
    second = {"like": "tractor", "kind": "rigid_truck"}
    refused({"units": {"second": second}}, "units.second")


def test_axles_are_in_order_of_their_positions_whatever_their_order_in_the_file(shipped):
    axle = {"like": "axle1", "position": 5.5}
    truck = TruckParameters.load(overlay={"units": {"trailer": {"axles": {"axle0": axle}}}})
    assert truck.last.axles[0].name == "trailer_axle0"
    assert truck.last.axles[1:] == shipped.last.axles


# --- units and bounds -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [(9.5, "t", 9500.0), (9500.0, "kg", 9500.0), (20_000.0, "lb", 9071.8474)],
)
def test_masses_are_converted_to_kilograms(value, unit, expected):
    overlay = {"units": {"tractor": {"mass": {"value": value, "unit": unit}}}}
    assert TruckParameters.load(overlay=overlay).lead.mass == pytest.approx(expected)


@pytest.mark.parametrize(
    ("section", "name", "value", "unit", "expected"),
    [
        ("engine", "idle_speed", 600, "rpm", 600 * RPM),
        ("engine", "engine_brake_power", 400, "kW", 400e3),
        ("engine", "drag_torque", [0.1, 0.2, 0.3], "kN m", [100.0, 200.0, 300.0]),
        ("air_brake", "pressure_max", 8.5, "bar", 850e3),
        ("air_brake", "abs_speed_min", 6, "km/h", 6 / 3.6),
        ("air_brake", "reservoir_volume", [30, 70, 100], "l", [0.03, 0.07, 0.1]),
        ("steering", "angle_max", 45, "deg", np.pi / 4),
        ("gearbox", "efficiency", 98, "%", 0.98),
    ],
)
def test_units_of_spec_sheets_are_converted(section, name, value, unit, expected):
    overlay = {section: {name: {"value": value, "unit": unit}}}
    found = getattr(getattr(TruckParameters.load(overlay=overlay), section), name)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        ("m", ("units.tractor.mass", "'m'", "'kg', 't'")),
        ("KG", ("units.tractor.mass", "'KG'", "'kg'")),
        (3, ("units.tractor.mass", "unit 3", "not text")),
    ],
)
def test_a_wrong_unit_is_refused_with_the_units_allowed(unit, words):
    refused({"units": {"tractor": {"mass": {"value": 9.0, "unit": unit}}}}, *words)


def test_an_unknown_entry_of_a_quantity_is_refused():
    leaf = {"value": 9e3, "units": "kg"}
    refused({"units": {"tractor": {"mass": leaf}}}, "units.tractor.mass", "'units'", "'unit'")


@pytest.mark.parametrize(
    ("overlay", "words"),
    [
        ({"units": {"tractor": {"mass": -1.0}}}, ("units.tractor.mass = -1 kg", "1 to 1e+06 kg")),
        (
            {"units": {"trailer": {"load_equalization": 1.5}}},
            ("units.trailer.load_equalization = 1.5", "0 to 1"),
        ),
        (
            {"units": {"tractor": {"axles": {"axle1": {"track": 0.0}}}}},
            ("units.tractor.axles.axle1.track = 0 m", "to 100 m"),
        ),
        (
            {"units": {"tractor": {"mass": {"value": 2e6, "unit": "t"}}}},
            ("units.tractor.mass = 2e+09 kg", "1 to 1e+06 kg"),
        ),
        ({"tires": {"steer": {"count": -1}}}, ("tires.steer.count = -1", "1 to 4")),
        ({"engine": {"boost_lag": True}}, ("engine.boost_lag = True", "finite number")),
        ({"units": {"tractor": {"axles": {"axle1": {"steered": 1}}}}}, ("steered = 1", "true or")),
        ({"gearbox": {"shift_strategy": 3}}, ("gearbox.shift_strategy = 3", "a word")),
        ({"gearbox": {"shift_strategy": "own"}}, ("shift_strategy", "'own'", "adaptive")),
        ({"gearbox": {"start_gear": 13}}, ("gearbox.start_gear = 13", "1 to 12")),
        ({"engine": {"drag_speed": 3.0}}, ("engine.drag_speed = 3.0", "a list")),
        ({"tires": {"steer": 4}}, ("tires.steer = 4", "a table")),
        ({"units": {"trailer": {"axles": {"axle1": 4}}}}, ("trailer.axles.axle1 = 4", "a table")),
        ({"units": {"trailer": {"kind": "caravan"}}}, ("units.trailer", "'caravan'", "dolly")),
        ({"units": {"trailer": {"coupling": {"kind": "rope"}}}}, ("'rope'", "fifth_wheel")),
        ({"units": {"trailer": {"kind": "tractor"}}}, ("units.trailer", "coupling")),
        ({"units": {"trailer": {"axles": {"axle1": {"tire": "wide"}}}}}, ("'wide'", "'steer'")),
        ({"units": {"trailer": {"axles": {"axle1": {"driven": True}}}}}, ("trailer_axle1",)),
        ({"units": {"tractor": {"axles": {"axle1": {"steered": False}}}}}, ("units.tractor",)),
        ({"units": {"tractor": {"axles": {"*": {"driven": False}}}}}, ("no driven axle",)),
        ({"units": {"trailer": {"colour": 1}}}, ("units.trailer.colour", "'mass'")),
        ({"motor": {}}, ("motor", "'engine'")),
        ({"engine": {"kilowatts": 400}}, ("engine.kilowatts", "'power'", "'full_load'")),
        ({"gearbox": {"gear": "g.csv"}}, ("gearbox.gear ", "'gears'", "'axle_loss'")),
        ({"remove": ["engine.idle_speed"]}, ("engine.idle_speed", "missing")),
        ({"remove": ["units.trailer.axles.*"]}, ("units.trailer has no axles",)),
        ({"remove": ["units"]}, ("[units]",)),
        ({"remove": ["units.tractor"]}, ("motor vehicle", "tractor", "rigid_truck")),
    ],
)
def test_errors_name_the_parameter_its_value_and_what_is_allowed(overlay, words):
    refused(overlay, *words)


# --- tables ---------------------------------------------------------------------------------

FULL_LOAD = "engine_speed [rpm],torque [N m]\n600,1000\n1000,2000\n1400,2000\n1900,1500\n"


def test_tables_are_found_beside_their_file_from_any_working_directory(
    write, monkeypatch, tmp_path
):
    file = write('[engine]\nfull_load = "load.csv"\n', load=FULL_LOAD)
    monkeypatch.chdir(tmp_path)
    engine = TruckParameters.load(file).engine
    assert engine.full_load_torque.tolist() == [1000.0, 2000.0, 2000.0, 1500.0]
    assert engine.full_load_speed[0] == pytest.approx(600 * RPM)
    # An overlay's tables lie beside the overlay.
    overlay = file.parent / "overlay.toml"
    overlay.write_text('[engine]\nfull_load = "load.csv"\n')
    assert TruckParameters.load(overlay=overlay).engine.full_load_torque[0] == 1000.0


def test_a_missing_table_is_refused_with_its_path(write):
    with pytest.raises(InputError, match=r"own.nothing\.csv"):
        TruckParameters.load(write('[engine]\nfull_load = "nothing.csv"\n'))


def test_pedal_of_another_full_load_curve_demands_a_share_of_the_rated_power(write):
    engine = TruckParameters.load(
        write('[engine]\nfull_load = "load.csv"\n', load=FULL_LOAD)
    ).engine
    pedal = engine.pedal_map
    assert pedal.columns[[0, -1]].tolist() == [0.0, 1.0]
    full = np.interp(pedal.rows, engine.full_load_speed, engine.full_load_torque)
    np.testing.assert_allclose(pedal.values[:, -1], full)
    half = pedal.values[:, 10] * pedal.rows
    weak = full * pedal.rows < 0.5 * engine.full_load_power
    np.testing.assert_allclose(half[~weak], 0.5 * engine.full_load_power)
    np.testing.assert_allclose(pedal.values[weak, 10], full[weak])


def test_a_third_column_of_the_full_load_curve_is_the_drag_torque(write):
    table = "engine_speed [rpm],torque [N m],drag [N m]\n600,1000,-100\n1900,1500,-300\n"
    engine = TruckParameters.load(write('[engine]\nfull_load = "load.csv"\n', load=table)).engine
    assert engine.drag_torque == (100.0, 300.0)
    assert engine.drag_speed == pytest.approx((600 * RPM, 1900 * RPM))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("speed,torque\n600,x\n", "cannot be read"),
        ("speed,torque\n600,inf\n", "finite"),
        ("speed,torque\n900,1000\n600,1000\n", "must rise"),
        ("speed,torque\n600\n900,4\n", "load.csv"),
    ],
)
def test_unusable_tables_are_refused(write, table, words):
    with pytest.raises(InputError, match=words):
        TruckParameters.load(write('[engine]\nfull_load = "load.csv"\n', load=table))


@pytest.mark.parametrize("factor", [0.5, 1.3])
def test_an_engine_of_another_power_has_all_torques_and_its_fuel_in_proportion(shipped, factor):
    base = shipped.engine
    overlay = {"engine": {"power": {"value": 1e-3 * factor * base.full_load_power, "unit": "kW"}}}
    engine = TruckParameters.load(overlay=overlay).engine
    assert engine.full_load_power == pytest.approx(factor * base.full_load_power)
    np.testing.assert_allclose(engine.full_load_torque, factor * base.full_load_torque)
    np.testing.assert_allclose(engine.pedal_map.values, factor * base.pedal_map.values)
    assert engine.inertia == pytest.approx(factor * base.inertia)
    assert engine.idle_fuel_rate == pytest.approx(factor * base.idle_fuel_rate)
    assert engine.drag_torque == pytest.approx([factor * torque for torque in base.drag_torque])
    # The same consumption per work at the same share of the load.
    speed, torque = 1200 * RPM, 0.4 * base.full_load_torque.max()
    assert engine.fuel_map.at(factor * torque, speed) == pytest.approx(
        base.fuel_map.at(torque, speed)
    )
    # Times and speeds stay.
    assert (engine.boost_lag, engine.idle_speed) == (base.boost_lag, base.idle_speed)


def test_a_number_given_after_the_power_is_not_scaled(write, shipped):
    file = write('[engine]\npower = { value = 300, unit = "kW" }\n')
    engine = TruckParameters.load(file, overlay={"engine": {"inertia": 3.0}}).engine
    assert engine.inertia == 3.0
    assert engine.full_load_power == pytest.approx(300e3)
    assert engine.reference_torque < shipped.engine.reference_torque


@pytest.mark.parametrize(
    ("engine", "words"),
    [
        ({"power": "much"}, ("engine.power = 'much'", "finite number")),
        ({"power": {"value": 300, "unit": "N"}}, ("engine.power", "'N'", "'kW'")),
        ({"power": 3e5, "inertia": "x"}, ("engine.inertia = 'x'", "finite number")),
        ({"power": 3e5, "drag_torque": [1.0, [2.0]]}, ("engine.drag_torque[1]",)),
        ({"power": 3e5, "full_load_torque": [1.0]}, ("engine.power", "the 0 W")),
    ],
)
def test_a_wrong_power_is_refused(engine, words):
    refused({"engine": engine}, *words)


@pytest.mark.parametrize("power", [1e3, 1e7])
def test_an_engine_of_another_family_is_refused(power):
    refused({"engine": {"power": power}}, f"engine.power = {power:g} W", "a fifth to five times")


def test_other_gears_have_shift_speeds_from_the_full_load_curve(write, shipped):
    gears = "gear,ratio\n1,6.0\n2,3.0\n3,1.5\n4,1.0\n"
    truck = TruckParameters.load(write('[gearbox]\ngears = "g.csv"\nstart_gear = 1\n', g=gears))
    gearbox = truck.gearbox
    assert gearbox.ratios.tolist() == [6.0, 3.0, 1.5, 1.0]
    assert gearbox.inertias.tolist() == [0.0] * 4
    assert gearbox.upshift.rows.tolist() == [1.0, 2.0, 3.0]
    assert gearbox.downshift.rows.tolist() == [2.0, 3.0, 4.0]
    # Later with more pedal and in higher gears; downshifts are due well below the same upshifts.
    assert (np.diff(gearbox.upshift.values, axis=1) >= 0.0).all()
    assert (np.diff(gearbox.upshift.values, axis=0) > 0.0).all()
    assert (gearbox.downshift.values < 0.95 * gearbox.upshift.values).all()
    # With full pedal at the speed of full power, after the shift above idle.
    radius = truck.tires[truck.driven_axles[0].tire].rolling_radius
    power = shipped.engine.full_load_torque * shipped.engine.full_load_speed
    at_full_power = shipped.engine.full_load_speed[np.argmax(power)]
    wheel = gearbox.upshift.values[2, -1] / radius * gearbox.final_drive
    assert wheel * gearbox.ratios[2] == pytest.approx(at_full_power)


@pytest.mark.parametrize(
    ("gears", "words"),
    [
        ("gear,ratio\n1,2.0\n2,3.0\n", "falling ratios"),
        ("gear,ratio\n1,2.0\n", "two or more gears"),
        ("gear,ratio\n1,2.0\n3,1.0\n", "gear 3 is not the next one"),
        ("gear,i\n1,2.0\n2,1.0\n", "'ratio'"),
        ("gear,ratio\n1,2.0\n2,0.0\n", "falling ratios"),
    ],
)
def test_unusable_gears_are_refused(write, gears, words):
    with pytest.raises(InputError, match=words):
        TruckParameters.load(write('[gearbox]\ngears = "g.csv"\nstart_gear = 1\n', g=gears))


LOSS = (
    "input_speed [rpm],input_torque [N m],torque_loss [N m]\n"
    "500,-1000,30\n500,0,10\n500,2000,50\n2000,-1000,40\n2000,0,20\n2000,2000,60\n"
)


def test_gears_have_maps_of_their_losses(write, shipped):
    gears = "gear,ratio,loss_map\n1,4.0,low.csv\n2,2.0,low.csv\n3,1.0,direct.csv\n"
    direct = LOSS.replace("50\n2000", "25\n2000")
    text = '[gearbox]\ngears = "g.csv"\nstart_gear = 1\naxle_loss = "axle.csv"\n'
    tables = {"g": gears, "low": LOSS, "direct": direct, "axle": LOSS}
    gearbox = TruckParameters.load(write(text, **tables)).gearbox
    assert gearbox.loss_map == (1, 1, 2)
    assert list(gearbox.loss_maps) == ["low.csv", "direct.csv"]
    low = gearbox.loss_maps["low.csv"]
    assert low.at(500 * RPM, 2000.0) == pytest.approx(50.0)
    assert low.at(1250 * RPM, 1000.0) == pytest.approx(35.0)
    assert gearbox.loss_maps["direct.csv"].at(500 * RPM, 2000.0) == pytest.approx(25.0)
    # Models without maps have the efficiency of the highest gear at half torque.
    torque = 0.5 * shipped.engine.full_load_torque.max()
    speed = shipped.engine.full_load_speed[np.argmax(shipped.engine.full_load_torque)]
    lost = gearbox.loss_maps["direct.csv"].at(speed, torque)
    assert gearbox.efficiency == pytest.approx(1.0 - lost / torque)
    assert 0.9 < gearbox.driveline_efficiency < 1.0


def test_a_loss_map_is_continued_along_its_slopes_where_speeds_have_other_torques(write):
    loss = (
        "input_speed,input_torque,torque_loss\n0,0,10\n0,100,20\n1000,0,30\n1000,100,40\n"
        "1000,300,60\n"
    )
    gears = "gear,ratio,loss_map\n1,2.0,loss.csv\n2,1.0,loss.csv\n"
    text = '[gearbox]\ngears = "g.csv"\nstart_gear = 1\n'
    found = TruckParameters.load(write(text, g=gears, loss=loss)).gearbox.loss_maps["loss.csv"]
    assert found.columns.tolist() == [0.0, 100.0, 300.0]
    np.testing.assert_allclose(found.values, [[10.0, 20.0, 40.0], [30.0, 40.0, 60.0]])


@pytest.mark.parametrize(
    ("loss", "words"),
    [
        ("input_speed,input_torque\n0,0\n", "no column 'torque_loss'"),
        ("input_speed,input_torque,torque_loss\n0,0,1\n9,0,1\n9,5,1\n", "two or more rows"),
        ("input_speed,input_torque,torque_loss\n0,0,1\n0,0,2\n", "two or more rows"),
    ],
)
def test_unusable_loss_maps_are_refused(write, loss, words):
    with pytest.raises(InputError, match=words):
        TruckParameters.load(write('[gearbox]\naxle_loss = "axle.csv"\n', axle=loss))


def test_a_map_of_the_fuel_rate_replaces_that_of_the_consumption(write):
    rate = "engine_speed [rpm],torque [N m],fuel [g/h]\n600,0,1000\n600,500,5000\n"
    rate += "1800,0,3600\n1800,500,18000\n1800,1000,36000\n"
    file = write('[engine]\nfuel_rate_map = "rate.csv"\n', rate=rate)
    engine = TruckParameters.load(file).engine
    assert not engine.fuel_map.values.size
    assert engine.fuel_rate_map.at(1800 * RPM, 1000.0) == pytest.approx(0.01)
    assert engine.fuel_rate_map.at(600 * RPM, 500.0) == pytest.approx(5.0 / 3600.0)
    back = write(
        f'[engine]\nfuel_map = "{truck_file(BASE).parent}/engine_fuel_map.csv"\n',
        name="back",
        extends='extends = "../own"\n',
    )
    assert not TruckParameters.load(back).engine.fuel_rate_map.values.size
    refused({"remove": ["engine.fuel_map"]}, "exactly one of fuel_map and fuel_rate_map")


def test_the_drag_of_an_empty_retarder_is_a_table(write):
    table = "retarder_speed [rpm],loss_torque [N m]\n0,10\n2000,30\n"
    retarder = TruckParameters.load(write('[retarder]\ndrag = "r.csv"\n', r=table)).retarder
    assert retarder.drag_torque == (10.0, 30.0)
    assert retarder.drag_speed == pytest.approx((0.0, 2000 * RPM))
