from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.messages import EgoFootprint, TrackedVehicle
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.elements import RoadType
from iits_mj.road.straight import straight_road
from iits_mj.road.writer import write
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation, Telemetry
from iits_mj.simulation.frame import DivergedError
from iits_mj.simulation.parts import load_map, make_stack, placed
from iits_mj.simulation.telemetry import COLUMNS
from tests.road.opendrive_text import document, line, road, successor
from traffic_bridge.network import nets


class Listener(Observer):
    """Observer that stores the times of its calls."""

    def __init__(self, period: float) -> None:
        self.period = period
        self.times: list[float] = []
        self.ego_times: list[float] = []

    def observe(self, simulation: Simulation, frame: DriveFrame) -> None:
        self.times.append(frame.time)
        self.ego_times.append(frame.ego.time)


def drive(**settings: object) -> tuple[Telemetry, Simulation]:
    telemetry = Telemetry(None)
    with Simulation(DriveConfig(**settings), visuals=False) as simulation:  # type: ignore[arg-type]
        simulation.run([telemetry])
    return telemetry, simulation


def table(telemetry: Telemetry) -> np.ndarray:
    numbers = [name for name in COLUMNS if name != "plan_mode [-]"]
    return np.array([telemetry.column(name) for name in numbers])


def test_drive_repeats_bit_for_bit_with_its_seed_and_differs_with_another() -> None:
    first = table(drive(duration=3.0, seed=4)[0])
    again = table(drive(duration=3.0, seed=4)[0])
    other = table(drive(duration=3.0, seed=5)[0])
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)


def test_reset_gives_the_same_drive_again_bit_for_bit() -> None:
    config = DriveConfig(duration=2.0, seed=1)
    with Simulation(config, visuals=False) as simulation:
        tables = []
        for _ in range(2):
            telemetry = Telemetry(None)
            simulation.run([telemetry])
            tables.append(table(telemetry))
            simulation.reset()
    assert np.array_equal(*tables, equal_nan=True)


def test_observers_of_any_period_do_not_change_the_drive() -> None:
    plain = table(drive(duration=1.0, traffic_mode="none")[0])
    telemetry = Telemetry(None)
    watchers = [Listener(0.05), Listener(0.034), Listener(0.002)]
    with Simulation(DriveConfig(duration=1.0, traffic_mode="none"), visuals=False) as simulation:
        simulation.run([telemetry, *watchers])
    assert np.array_equal(plain, table(telemetry), equal_nan=True)
    for watcher in watchers:
        expected = np.arange(0.0, 1.0 + 1e-9, watcher.period)
        np.testing.assert_allclose(watcher.times, expected, atol=1e-9)
        np.testing.assert_allclose(watcher.ego_times, expected, atol=1e-9)


def test_rows_are_100_ms_apart_and_the_distance_is_that_of_the_stations() -> None:
    telemetry, simulation = drive(duration=3.0, traffic_mode="none")
    np.testing.assert_allclose(telemetry.column("time [s]"), np.arange(31) * 0.1, atol=1e-12)
    station = telemetry.column("station [m]")
    assert simulation.summary().distance == pytest.approx(station[-1] - station[0], abs=0.05)
    assert simulation.ended == "reached the end of the time"


@pytest.mark.parametrize(("asked", "lane"), [("map", 1), ("off", 1), ("on", 0)])
def test_a_truck_that_keeps_right_leaves_the_left_lane(asked: str, lane: int) -> None:
    _, simulation = drive(
        duration=10.0,
        traffic_mode="none",
        speed_planner="cruise",
        decision="keep",
        start_lane=1,
        keep_right=asked,
    )
    assert simulation.frame.lane == lane
    assert simulation.stack.lane_changes == 1 - lane


def test_the_map_says_whether_the_truck_keeps_right(tmp_path: Path) -> None:
    road = straight_road(2_000.0, 2, 4.0, 25.0, 0.0, 0.8)
    types = (RoadType(0.0, "motorway", 25.0, country="DE"),)
    german = dataclasses.replace(road.roads[0], types=types)
    path = tmp_path / "german.xodr"
    write(dataclasses.replace(road, roads=(german,)), path)
    for asked, keeps in (("map", True), ("off", False)):
        config = DriveConfig(map=path, keep_right=asked, speed_planner="cruise")
        stack = make_stack(config, load_map(path).route(), TruckParameters.load())
        assert stack.planner.config.keep_right is keeps


def test_drive_ends_before_the_end_of_the_route() -> None:
    end = 15_000.0
    telemetry, simulation = drive(duration=60.0, start_station=end - 40.0, traffic_mode="none")
    assert simulation.ended == "reached the end of the route"
    assert telemetry.column("station [m]")[-1] < simulation.route.length
    assert telemetry.column("time [s]")[-1] < 30.0


@pytest.mark.parametrize(
    ("settings", "reported"),
    [
        ({"start_station": 1.0}, "start-station 1 m is not on the route"),
        ({"start_station": 14_999.0}, "is not on the route"),
        ({"start_lane": 2}, "start-lane 2 does not exist"),
        ({"payload": 40_000.0}, "payload = 40000.0 kg: allowed is 0 to 36000 kg"),
        ({"duration": float("nan")}, "duration nan is not a finite number"),
        ({"density": "full"}, "density 'full' is not known"),
    ],
)
def test_unusable_configuration_is_one_clear_error(
    settings: dict[str, object], reported: str
) -> None:
    with pytest.raises(InputError, match=reported):
        Simulation(DriveConfig(**settings), visuals=False)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("length", "station"), [(1000.0, 60.0), (70.0, 16.5), (40.0, 16.5), (25.0, 11.1), (20.0, 11.1)]
)
def test_the_default_start_fits_a_short_road(length: float, station: float) -> None:
    start = placed(DriveConfig(), Route.straight(length=length), EgoFootprint())
    assert start.start_station == pytest.approx(station)


@pytest.mark.parametrize(("point", "station"), [(250.0, 250.0), (3.0, 16.5), (499.0, 485.0)])
def test_a_drive_starts_at_the_first_point_of_its_route(point: float, station: float) -> None:
    route = Route.straight(length=500.0)
    route.start = point
    start = placed(DriveConfig(), route, EgoFootprint()).start_station
    assert start == pytest.approx(station)
    assert placed(DriveConfig(start_station=100.0), route, EgoFootprint()).start_station == 100.0


def test_a_given_start_may_leave_the_trailer_before_the_route() -> None:
    # The truck's rear is 3.6 m before the beginning; at 5 m it would have left the road.
    route = Route.straight(length=500.0)
    assert placed(DriveConfig(start_station=11.5), route, EgoFootprint()).start_station == 11.5
    with pytest.raises(InputError, match="use 12 to 485 m"):
        placed(DriveConfig(start_station=10.0), route, EgoFootprint())


def test_without_traffic_a_map_drives_along_its_route_without_netconvert(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "two.xodr"
    path.write_text(document(road("a", link=successor("b")), road("b", line(100.0)), road("c")))

    def missing() -> Path:
        raise TrafficError("netconvert is missing")

    monkeypatch.setattr(nets, "find_netconvert", missing)
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    settings = {"map": path, "route": "a,b", "duration": 1.0}
    simulation = drive(**settings, traffic_mode="none", traffic_scope="map")[1]
    assert [part.road_id for part in simulation.route.segments] == ["a", "b"]
    with pytest.raises(TrafficError, match="netconvert is missing"):
        drive(**settings)


def test_a_route_that_the_map_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="there is no road 'elm' for the route"):
        Simulation(DriveConfig(route="elm,oak"), visuals=False)
    with pytest.raises(InputError, match="'up' is no turn"):
        DriveConfig(route="turns:east,up,down")


def test_a_road_shorter_than_the_truck_is_refused_with_its_least_length() -> None:
    with pytest.raises(InputError, match=r"12.0 m long; the truck of 16.5 m needs 1\d\.\d m"):
        placed(DriveConfig(), Route.straight(length=12.0), EgoFootprint())


def test_lanes_narrower_than_vehicles_are_refused() -> None:
    with pytest.raises(InputError, match=r"lane 0 is 1.8 m wide"):
        placed(DriveConfig(), Route.straight(lane_width=1.8), EgoFootprint())


def test_driving_into_a_standing_vehicle_ends_as_a_collision() -> None:
    config = DriveConfig(duration=20.0, traffic_mode="none", decision="keep")
    with Simulation(config, visuals=False) as simulation:
        simulation.cycle()
        ego = simulation.frame.ego
        # A vehicle that appears inside the truck, so that no controller can avoid it.
        place = simulation.route.evaluate(ego.station + 2.0, ego.offset)
        simulation.vehicles = (
            TrackedVehicle(
                "wall",
                x=float(place.x),
                y=float(place.y),
                z=float(place.z),
                yaw=float(place.heading),
                station=ego.station + 2.0,
                offset=ego.offset,
            ),
        )
        simulation.cycle()
    assert simulation.collision
    assert simulation.summary().failed
    assert "collision with wall" in simulation.ended


def test_state_that_is_not_finite_stops_with_an_error() -> None:
    with Simulation(DriveConfig(traffic_mode="none"), visuals=False) as simulation:
        simulation.cycle()
        simulation.truck.data.qvel[0] = np.nan
        with pytest.raises(DivergedError, match="the simulation diverged"):
            simulation.cycle()
    summary = simulation.summary()
    assert summary.failed
    assert summary.ended.startswith("the simulation diverged")
    assert summary.duration == pytest.approx(0.1)


def test_stopped_drive_keeps_its_rows_and_replaces_an_older_table_whole(tmp_path: Path) -> None:
    path = tmp_path / "telemetry.csv"
    path.write_text("older")
    config = DriveConfig(duration=5.0, traffic_mode="none")

    def interrupt(frame: DriveFrame) -> None:
        assert path.read_text() == "older"
        raise KeyboardInterrupt

    with (
        pytest.raises(KeyboardInterrupt),
        Simulation(config, visuals=False) as simulation,
        Telemetry(path) as telemetry,
    ):
        simulation.run([telemetry], interrupt)
    rows = list(csv.reader(path.open()))
    assert len(rows) == 3
    assert [p.name for p in tmp_path.iterdir()] == ["telemetry.csv"]


def test_columns_in_a_file_equal_those_in_memory_also_when_read_during_the_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = DriveConfig(duration=1.0, traffic_mode="none")
    tables = []
    for size in (10**9, 1000):
        monkeypatch.setattr("iits_mj.simulation.telemetry._IN_MEMORY", size)
        monkeypatch.setattr("iits_mj.simulation.telemetry._ROWS_READ", 4)
        telemetry = Telemetry(None)

        def read(frame: DriveFrame, telemetry: Telemetry = telemetry) -> None:
            assert telemetry.column("time [s]")[-1] == frame.time

        with Simulation(config, visuals=False) as simulation:
            simulation.run([telemetry], read)
        tables.append([telemetry.column(name) for name in COLUMNS])
    assert len(telemetry) == len(tables[0][0]) == 11
    np.testing.assert_array_equal(*tables)
    assert np.isnan(telemetry.column("plan_mode [-]")).all()


def test_table_has_no_nan_or_inf(tmp_path: Path) -> None:
    path = tmp_path / "telemetry.csv"
    config = DriveConfig(duration=0.5 + 0.5, traffic_mode="none")
    with Simulation(config, visuals=False) as simulation, Telemetry(path) as telemetry:
        simulation.run([telemetry])
    text = path.read_text()
    assert "nan" not in text
    assert "inf" not in text
    header, first = list(csv.reader(path.open()))[:2]
    assert all(name.endswith("]") and "[" in name for name in header)
    assert first[header.index("gap_ahead [m]")] == ""


def test_recorded_traffic_is_replayed_exactly(tmp_path: Path) -> None:
    path = tmp_path / "traffic.npz"
    config = DriveConfig(duration=2.0, seed=2)
    with Simulation(config, record=True, visuals=False) as simulation:
        simulation.run()
        simulation.save_recording(path)
        recorded = simulation.vehicles
    with Simulation(DriveConfig(duration=2.0, recording=path), visuals=False) as replay:
        replay.run()
        met = {vehicle.id: vehicle for vehicle in replay.vehicles}
    assert recorded
    for vehicle in recorded:
        assert (met[vehicle.id].x, met[vehicle.id].y) == pytest.approx((vehicle.x, vehicle.y))


@pytest.mark.slow
@pytest.mark.parametrize(("payload", "seed"), [(36_000.0, 0), (0.0, 1)])
def test_23_minutes_of_traffic_leave_no_warning(payload, seed):
    config = DriveConfig(payload=payload, seed=seed, speed=9.8, start_speed=9.0, duration=1380.0)
    # On a free road the plan exceeds this slow cruise speed where that saves fuel and reaches the
    # end of the road within 25 minutes.
    with Simulation(config) as simulation:
        summary = simulation.run()
        data = simulation.truck.data
    assert summary.ended == "reached the end of the time"
    assert not summary.collision
    assert not data.warning.number.any()
    assert np.isfinite(data.qpos).all()
    assert np.isfinite(data.sensordata).all()
