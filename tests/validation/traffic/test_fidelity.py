import json

import numpy as np
import pytest

from iits_mj.cli import main
from iits_mj.core.errors import InputError
from iits_mj.core.vehicles import COLUMNS, TrackedVehicle
from iits_mj.validation.traffic import conditions as conditions_of
from iits_mj.validation.traffic.compare import drive
from iits_mj.validation.traffic.flow import (
    FlowLog,
    FlowSamples,
    kolmogorov_smirnov,
    lane_change_rate,
    levels,
    matched,
    wasserstein,
)
from iits_mj.validation.traffic.group import own_recording
from iits_mj.validation.traffic.levels import RoadSample, compare_levels
from tests.paths import DATA, needs
from traffic_bridge import VehicleFrame
from traffic_bridge.datasets import Trajectories
from traffic_bridge.vehicles.idm import IdmParameters, equilibrium_gap

PAIRS = "trajectories/ngsim_i80_1600_1615_reconstructed_pairs.parquet"


def _samples(speed, spacing=None, time=None, lane=None, station=None, weight=None):
    n = len(speed)

    def column(values, default, kind=float):
        return np.full(n, default, dtype=kind) if values is None else np.asarray(values, dtype=kind)

    return FlowSamples(
        column(time, 0.0),
        column(lane, 0, np.int64),
        column(station, 10.0),
        np.asarray(speed, dtype=float),
        column(spacing, 20.0),
        column(weight, 1.0),
    )


def _frame(*rows):
    """A frame of (id, lane, middle station, speed), every vehicle 4 m long."""
    columns = np.zeros((len(COLUMNS), len(rows)))
    for i, (_, _, station, speed) in enumerate(rows):
        columns[COLUMNS.index("station"), i] = station
        columns[COLUMNS.index("speed"), i] = speed
        columns[COLUMNS.index("length"), i] = 4.0
    lanes = np.array([row[1] for row in rows])
    return VehicleFrame([row[0] for row in rows], ["car"] * len(rows), lanes, columns)


def test_distances_of_shifted_flows_are_the_shift():
    speed = np.random.default_rng(0).normal(10.0, 2.0, 500)
    a, b = _samples(speed), _samples(speed + 1.5)
    assert wasserstein(a, a) == 0.0
    assert kolmogorov_smirnov(a, a) == 0.0
    assert wasserstein(a, b) == pytest.approx(1.5)
    assert 0.2 < kolmogorov_smirnov(a, b) < 0.4
    assert kolmogorov_smirnov(a, _samples(speed + 100.0)) == pytest.approx(1.0)


def test_weights_count_as_repeated_vehicles():
    twice = _samples([5.0, 5.0, 9.0])
    weighted = _samples([5.0, 9.0], weight=[2.0, 1.0])
    assert wasserstein(twice, weighted) == pytest.approx(0.0, abs=1e-12)
    assert kolmogorov_smirnov(twice, weighted) == pytest.approx(0.0, abs=1e-12)


def test_only_common_cells_of_both_flows_are_compared():
    recorded = _samples([8.0, 9.0, 30.0], station=[10.0, 20.0, 310.0])
    simulated = _samples([8.0, 8.0, 10.0, 10.0, 99.0], station=[5.0, 15.0, 25.0, 35.0, 700.0])
    ours, theirs = matched(recorded, simulated)
    assert ours.speed.tolist() == [8.0, 9.0]
    assert theirs.speed.tolist() == [8.0, 8.0, 10.0, 10.0]
    assert theirs.weight.sum() == pytest.approx(len(ours))


def test_levels_are_thirds_ordered_by_spacing():
    spacing = np.repeat([10.0, 20.0, 40.0], 50)
    flow = _samples(np.full(150, 8.0), spacing, station=np.repeat([10.0, 110.0, 210.0], 50))
    cells = levels(flow)
    for name, expected in (("dense", 10.0), ("medium", 20.0), ("sparse", 40.0)):
        assert set(flow.spacing[np.isin(flow.cells(), cells[name])]) == {expected}


def test_log_finds_leaders_in_the_lane_and_counts_lane_changes():
    log = FlowLog()
    log.add(0.0, _frame(("a", 0, 100.0, 10.0), ("b", 0, 130.0, 10.0), ("c", 1, 110.0, 10.0)))
    log.add(1.0, _frame(("a", 1, 110.0, 10.0), ("b", 0, 140.0, 10.0), ("c", 1, 120.0, 10.0)))
    spacing = log.samples.spacing
    assert sorted(spacing[np.isfinite(spacing)]) == [10.0, 30.0]
    assert log.samples.station.max() == 142.0
    assert log.lane_changes == 1
    assert log.lane_change_rate == pytest.approx(1.0 / 0.030)


def test_lane_changes_of_a_recorded_set_are_per_vehicle_and_kilometer():
    n = 11
    data = Trajectories(
        source="made up", ids=("a",), kinds=("car",), length=[4.5], width=[1.8],
        time=0.1 * np.arange(n), vehicle=np.zeros(n), lane=[0] * 5 + [1] * 6,
        station=np.linspace(0.0, 100.0, n), offset=np.zeros(n), speed=np.full(n, 50.0),
        acceleration=np.zeros(n), leader=np.full(n, -1), lane_count=2,
    )  # fmt: skip
    assert lane_change_rate(data) == (1, pytest.approx(0.1))


def test_replayed_traffic_equals_its_source():
    assert [check.value for check in own_recording(5.0).checks] == [0.0, 0.0]


def _queue():
    """Artificial recorded conditions: one lane, 300 m, a speed of 8 m/s that drops to 4 m/s."""
    time = np.arange(0.0, 100.0, 0.5)
    speed = np.where(time < 50.0, 8.0, 4.0)
    rows = [
        (t, s, v) for t, v in zip(time, speed, strict=True) for s in (20.0, 120.0, 220.0, 299.0)
    ]
    t, s, v = np.array(rows).T
    flow = _samples(v, np.full(len(v), 15.0), t, station=s)
    return conditions_of.Conditions.of(flow, flow, 4.5)


def test_a_queue_drives_as_fast_as_its_end_and_keeps_its_equilibrium_distance():
    # The driver's string is stable: an unstable string would amplify changes at the exit.
    driver = IdmParameters(20.0, 1.6, 2.0, 1.5, 1.5)
    conditions = _queue()
    flow = drive(conditions, lambda _lane, _rng: driver, (0.0, 100.0))
    early = flow.select((flow.time > 30.0) & (flow.time < 45.0) & (flow.station > 100.0))
    early = conditions_of.compared(early, conditions)
    assert early.speed == pytest.approx(8.0, abs=0.3)
    expected = float(equilibrium_gap(driver.as_array(), early.speed.mean())) + 4.5
    assert np.nanmean(early.spacing) == pytest.approx(expected, rel=0.03)
    # The slower speed travels upstream with (s0 + length) / T, about 4 m/s, from 299 m on.
    late = conditions_of.compared(flow.select(flow.time > 92.0), conditions)
    assert late.speed[late.station > 180.0] == pytest.approx(4.0, abs=0.4)
    assert late.speed[late.station < 40.0].mean() > 4.8


def test_a_lane_without_leaders_is_refused():
    flow = _samples([8.0, 8.0], [np.nan, np.nan], [0.0, 1.0], station=[10.0, 290.0])
    with pytest.raises(InputError, match="lane 0: no vehicle behind a leader"):
        conditions_of.Conditions.of(flow, flow, 4.5)


def test_command_without_data_runs_the_other_checks_and_names_the_option(capsys):
    assert main(["validate", "traffic", "--quick", "--json"]) == 2
    out, err = capsys.readouterr()
    checks = json.loads(out)["checks"]
    assert all(check["ok"] for check in checks)
    assert {c["name"].split()[0] for c in checks} >= {"equilibrium", "oscillation", "RepSim"}
    assert "--data FILE" in err
    assert err.count("\n") == 1


def test_missing_data_file_is_an_error(capsys):
    assert main(["validate", "traffic", "--quick", "--data", "/nowhere/tracks.csv"]) == 2
    assert "/nowhere/tracks.csv" in capsys.readouterr().err


@pytest.mark.slow
@needs(PAIRS)
def test_calibrated_traffic_has_the_speeds_of_the_recorded_one(capsys):
    code = main(["validate", "traffic", "--json", "--data", str(DATA / PAIRS)])
    checks = {c["name"]: c for c in json.loads(capsys.readouterr().out)["checks"]}
    assert checks["calibrated, all: speed, Wasserstein"]["value"] <= 1.0
    error = "gap error of {}, pairs not fitted to"
    fitted, default = (checks[error.format(who)]["value"] for who in ("one set", "the default car"))
    assert fitted < default
    assert code == (0 if all(check["ok"] for check in checks.values()) else 1)


def test_sample_of_a_road_has_density_gaps_and_lanes_of_its_vehicles():
    sample = RoadSample(0.0, 1_000.0)
    rows = [
        *((f"a{k}", 100.0 * k, 0, 20.0) for k in range(10)),
        *((f"b{k}", 200.0 * k, 1, 25.0) for k in range(5)),
        ("beyond", 1_050.0, 0, 20.0),
    ]
    frame = VehicleFrame.of(
        TrackedVehicle(name, station=station, lane=lane, speed=speed, length=5.0)
        for name, station, lane, speed in rows
    )
    sample.add(0.0, frame)
    assert sample.density(2) == pytest.approx(15.0 / 2_000.0)
    assert sample.speed == pytest.approx((10 * 20.0 + 5 * 25.0) / 15.0)
    assert sorted(set(sample.time_gaps.round(9))) == [95.0 / 20.0, 195.0 / 25.0]
    shares, speeds = zip(*sample.lanes(), strict=True)
    assert shares == pytest.approx((2.0 / 3.0, 1.0 / 3.0))
    assert speeds == pytest.approx((20.0, 25.0))


@pytest.mark.slow
def test_traffic_of_every_level_has_density_flow_and_speed_within_10_percent():
    found = compare_levels(quick=False)
    short = [check.name for check in found.checks if not check.ok]
    assert not short
