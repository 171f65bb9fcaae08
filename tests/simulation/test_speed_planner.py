"""The reference speed of a drive: PCC, cruise or a speed profile, and their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from controllers.pcc import PccReference
from controllers.planning.speed_reference import CruiseReference, ProfileReference
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.simulation import DriveConfig, Simulation, Telemetry
from iits_mj.simulation.parts import make_reference, make_stack
from iits_mj.simulation.telemetry import speed_object

PARAMETERS = TruckParameters.load()


@pytest.fixture(scope="module")
def route() -> Route:
    return RoadMap.builtin().route()


def reference(route: Route, **settings: object) -> object:
    return make_reference(DriveConfig(**settings), route, PARAMETERS)  # type: ignore[arg-type]


def profile(path: Path, first: float, last: float) -> Path:
    path.write_text(f"station_m,speed_mps\n{first},14\n{last},12\n", encoding="utf-8")
    return path


def test_each_speed_planner_has_its_reference(route: Route, tmp_path: Path) -> None:
    assert isinstance(reference(route, speed_planner="pcc"), PccReference)
    assert isinstance(reference(route, speed_planner="cruise"), CruiseReference)
    file = profile(tmp_path / "speed.csv", 0.0, 900.0)
    assert isinstance(reference(route, speed_profile=file), ProfileReference)


def test_speed_range_is_lawful_by_default_and_can_be_set(route: Route) -> None:
    found = reference(route, speed_planner="pcc", speed=20.0)
    assert isinstance(found, PccReference)
    assert (found.config.v_min, found.config.v_max) == (15.0, 25.0)
    assert found.road.v_limit.max() == pytest.approx(80.0 / 3.6, abs=0.01)
    reported = reference(route, speed_planner="pcc", speed=20.0, speed_min=18.0, speed_max=21.0)
    assert isinstance(reported, PccReference)
    assert (reported.config.v_min, reported.config.v_max) == (18.0, 21.0)


@pytest.mark.parametrize("band", [{"speed_min": 21.0}, {"speed_max": 19.0}])
def test_a_reference_speed_outside_its_range_is_refused(route: Route, band: dict) -> None:
    with pytest.raises(InputError, match=r"speed 20 m/s is outside"):
        reference(route, speed_planner="pcc", speed=20.0, **band)


def test_a_speed_range_without_pcc_is_refused(route: Route) -> None:
    with pytest.raises(InputError, match="speed-planner pcc"):
        reference(route, speed_planner="cruise", speed_min=12.0)


@pytest.mark.parametrize(
    "beside", [{"speed_min": 15.0}, {"speed_max": 20.0}, {"speed_planner": "cruise"}]
)
def test_flags_that_contradict_a_profile_are_refused(
    route: Route, tmp_path: Path, beside: dict
) -> None:
    file = profile(tmp_path / "speed.csv", 0.0, 900.0)
    with pytest.raises(InputError, match="followed unchanged"):
        reference(route, speed_profile=file, **beside)


def test_json_has_the_reason_of_a_cruise_that_replaces_pcc() -> None:
    short = Route.straight(length=150.0)
    found = {}
    for planner in ("pcc", "cruise"):
        config = DriveConfig(speed_planner=planner, speed=15.0)
        found[planner] = speed_object(make_stack(config, short, PARAMETERS))
    assert found["pcc"]["speed_planner"]["fallback"] == "cruise"
    assert "too short" in found["pcc"]["speed_planner"]["reason"]
    assert found["cruise"] == {}


def test_a_profile_of_another_road_is_refused(route: Route, tmp_path: Path) -> None:
    file = profile(tmp_path / "speed.csv", 0.0, 900.0)
    with pytest.raises(InputError, match="nothing of it lies ahead"):
        reference(route, speed_profile=file, start_station=1000.0)


def test_a_road_too_short_to_plan_is_driven_at_the_reference_speed() -> None:
    found = reference(Route.straight(length=150.0), speed_planner="pcc", speed=15.0)
    assert isinstance(found, CruiseReference)
    assert "too short" in found.reason
    assert found.at(50.0) == 15.0


def test_drive_with_pcc_repeats_bit_for_bit() -> None:
    config = DriveConfig(speed_planner="pcc", traffic_mode="none", duration=3.0)
    with Simulation(config, visuals=False) as simulation:
        tables = []
        for _ in range(2):
            telemetry = Telemetry(None)
            simulation.run([telemetry])
            tables.append([telemetry.column(n) for n in ("speed [m/s]", "reference_speed [m/s]")])
            simulation.reset()
    assert np.array_equal(*tables)


def test_drive_follows_a_profile(tmp_path: Path) -> None:
    file = profile(tmp_path / "speed.csv", 0.0, 200.0)
    config = DriveConfig(
        speed_profile=file, traffic_mode="none", duration=8.0, start_speed=14.0, payload=0.0
    )
    telemetry = Telemetry(None)
    with Simulation(config, visuals=False) as simulation:
        simulation.run([telemetry])
    station = telemetry.column("station [m]")
    wanted = np.interp(station, [0.0, 200.0], [14.0, 12.0])
    assert telemetry.column("reference_speed [m/s]") == pytest.approx(wanted)
    assert np.abs(telemetry.column("speed [m/s]") - wanted)[30:].max() < 0.6
