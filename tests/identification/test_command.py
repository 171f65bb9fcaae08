"""`iits-mj identify`: inputs, outputs and errors."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.identification import IdentifyConfig, Log, Series, identify, read_table, run
from iits_mj.identification.log import read_grade
from iits_mj.parameters import TruckParameters
from tests.identification.point_mass import MASS, PARAMETERS, drive

# Without pressures; the mode of the demand shows the use of the brakes.
SEEN = "speed,grade,gear,engine_torque,shift_in_process,command_xbr_mode"


@pytest.fixture(scope="module")
def log():
    return drive(duration=300.0)


@pytest.fixture(scope="module")
def table(log, tmp_path_factory):
    """The log as a telemetry table with customary units."""
    units = {"engine_torque": ("N m", 1.0), "speed": ("km/h", 3.6)}
    header, data = [], []
    for name, values in log.signals.items():
        kpa = ("kPa", 1e-3) if name.startswith("brake_pressure") else ("-", 1.0)
        unit, factor = units.get(name, kpa)
        header.append(f"{name} [{unit}]")
        data.append(values * factor)
    path = tmp_path_factory.mktemp("log") / "telemetry.csv"
    rows = [",".join(f"{x:.9g}" for x in row) for row in np.column_stack(data)]
    path.write_text("\n".join([",".join([*header, "note [-]"]), *[f"{row}," for row in rows]]))
    return path


def test_table_with_customary_units_identifies_the_truck_and_writes_its_overlay(table, tmp_path):
    output = tmp_path / "overlay.toml"
    report = run(IdentifyConfig(log=table, output=output))
    assert report.command == "identify"
    mass = next(check for check in report.checks if check.name == "mass")
    assert mass.value == pytest.approx(MASS, rel=0.05)
    assert report.figures["identification"]
    text = output.read_text()
    assert "# mass = " in text
    assert "# front_dead_time: not identifiable" in text
    loaded = TruckParameters.load(overlay=output)
    assert loaded.gross_mass(loaded.payload_max) == pytest.approx(mass.value, rel=1e-6)
    gain = next(check.value for check in report.checks if check.name == "brake_gain")
    slope = gain * PARAMETERS.axles[3].brake.torque_per_pressure
    assert loaded.axles[3].brake.torque_per_pressure == pytest.approx(slope, rel=1e-6)
    share = loaded.payload_max / PARAMETERS.payload_max
    assert loaded.last.payload.inertia_z == pytest.approx(share * PARAMETERS.last.payload.inertia_z)


def test_left_out_signals_are_not_used(table):
    report = run(IdentifyConfig(log=table, signals=SEEN))
    assert any(check.name == "mass" for check in report.checks)
    assert not any(check.name == "brake_gain" for check in report.checks)
    assert any("brake_gain: not identifiable" in note for note in report.notes)


def test_signals_option_names_columns_with_other_titles(table, tmp_path):
    renamed = tmp_path / "foreign.csv"
    renamed.write_text(table.read_text().replace("speed [km/h]", "v [km/h]", 1))
    own = run(IdentifyConfig(log=table, signals=SEEN))
    other = run(IdentifyConfig(log=renamed, signals=SEEN.replace("speed", "speed=v")))
    assert [c.value for c in other.checks] == [c.value for c in own.checks]


def test_grade_is_read_from_a_number_or_a_table(log, tmp_path):
    level = read_grade("0.02", log)
    assert np.all(level["grade"] == 0.02)
    path = tmp_path / "road.csv"
    path.write_text("station [m],grade [-]\n0,0.01\n1000,0.03\n")
    sloped = read_grade(str(path), log)["grade"]
    assert sloped[0] == pytest.approx(0.01)
    assert sloped[-1] == pytest.approx(0.03)
    with pytest.raises(InputError, match="grade"):
        read_grade("0.9", log)
    with pytest.raises(InputError, match="cannot be read"):
        read_grade("nowhere.csv", log)


def test_unusable_tables_give_one_clear_error(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "missing.csv")
    path = tmp_path / "log.csv"
    path.write_text("")
    with pytest.raises(InputError, match="empty"):
        read_table(path)
    path.write_text("time [s],speed [m/s]\n0,abc\n")
    with pytest.raises(InputError, match="speed"):
        read_table(path)
    path.write_text("speed [m/s]\n0\n")
    with pytest.raises(InputError, match="lacks"):
        read_table(path)
    with pytest.raises(InputError, match="no column 'v'"):
        read_table(path, {"speed": "v"})
    rows = "".join(f"{row},1e305\n" for row in range(60))
    path.write_text(f"time [s],brake_pressure_trailer [bar]\n{rows}")
    with pytest.raises(InputError, match=r"brake_pressure_trailer.*not finite"):
        read_table(path)


def test_unusable_signals_give_one_clear_error(log):
    signals = dict(log.signals)
    rows = len(signals["time"])
    with pytest.raises(InputError, match="not finite"):
        Log({**signals, "speed": np.full(rows, np.nan)})
    with pytest.raises(InputError, match="increase"):
        Log({**signals, "time": np.zeros(rows)})
    with pytest.raises(InputError, match="at least 50"):
        Log({name: values[:20] for name, values in signals.items()})
    with pytest.raises(InputError, match="lacks the signal 'time'"):
        Log({"speed": np.zeros(100)})
    with pytest.raises(InputError, match="cannot identify 'hope'"):
        identify(log, PARAMETERS, groups=("hope",))
    with pytest.raises(InputError, match="lacks the signal 'yaw_rate'"):
        log.only(["yaw_rate"])


def test_each_signal_keeps_its_own_sample_times():
    slow = Series(np.arange(0.0, 30.0, 0.5), np.arange(60.0))
    fast = Series(np.arange(0.0, 30.0, 0.1), np.zeros(300))
    log = Log({"speed": slow, "yaw_rate": fast})
    assert len(log.series("speed").time) == 60
    assert log.at("speed", [0.25])[0] == pytest.approx(0.5)
    assert log.held("speed", [0.49, 0.5])[0] == 0.0
    assert log.held("speed", [0.5])[0] == 1.0


def test_standing_truck_gives_an_error_and_no_overlay(tmp_path):
    path = tmp_path / "still.csv"
    rows = [f"{0.1 * k:.1f},0,0,0,0" for k in range(100)]
    path.write_text("time,speed,grade,gear,engine_torque\n" + "\n".join(rows))
    with pytest.raises(InputError, match="shows no parameter"):
        run(IdentifyConfig(log=path, output=tmp_path / "none.toml"))
    assert not (tmp_path / "none.toml").exists()
