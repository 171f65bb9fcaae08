"""Traffic of the user's own: its guard, and vehicles that are placed on a route."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import TrackedVehicle, VehicleFrame
from iits_mj.road import RoadMap, Route
from traffic_bridge import OwnTraffic, Recorder, RepSim, ReSim, Traffic, TrafficSource, vehicle_on

ROAD = Route.straight(length=1_000.0, lanes=2)
EGO = EgoState(station=100.0, x=100.0)
CAR = TrackedVehicle("car", x=150.0, station=150.0)


class Given:
    """A traffic that returns what it was made with."""

    def __init__(self, vehicles: Any) -> None:
        self.vehicles, self.closed = vehicles, 0

    def reset(self, ego: EgoState) -> Any:
        return self.vehicles

    def step(self, ego: EgoState) -> Any:
        return self.vehicles

    def close(self) -> None:
        self.closed += 1


class Minimal:
    def reset(self, ego: EgoState) -> list[TrackedVehicle]:
        return [CAR]

    def step(self, ego: EgoState) -> list[TrackedVehicle]:
        return []


def test_a_traffic_needs_two_methods_and_gets_the_rest() -> None:
    traffic = OwnTraffic(Minimal(), ROAD)
    assert isinstance(Minimal(), TrafficSource)
    assert isinstance(traffic, Traffic)
    assert traffic.reset(EGO).ids == ("car",)
    assert traffic.step(EGO) == VehicleFrame.empty()
    assert traffic.time == pytest.approx(0.1)
    assert traffic.signal_controller() is None
    assert traffic.exact_vehicles(0.05) is None
    traffic.close()
    traffic.reset(EGO)
    assert traffic.time == 0.0


def test_further_methods_of_the_part_are_used() -> None:
    part = Given([CAR])
    part.exact_vehicles = lambda time: [dataclasses.replace(CAR, x=time)]  # type: ignore[attr-defined]
    traffic = OwnTraffic(part, ROAD)
    exact = traffic.exact_vehicles(7.0)
    assert exact is not None
    assert exact[0].x == 7.0
    traffic.close()
    assert part.closed == 1
    assert traffic.vehicles == [CAR]


@pytest.mark.parametrize(
    ("vehicles", "message"),
    [
        (None, "a frame is made of TrackedVehicles, not of None"),
        (["car"], "'car' is none"),
        ([dataclasses.replace(CAR, speed=math.nan)], "vehicle 'car': speed is nan"),
        ([CAR, CAR], "vehicle 'car' occurs twice"),
        ([dataclasses.replace(CAR, kind="bus")], "vehicle 'car' of kind 'bus'; use one of: car"),
    ],
)
def test_unusable_vehicles_are_refused_with_the_name_of_the_part(
    vehicles: Any, message: str
) -> None:
    traffic = OwnTraffic(Given(vehicles), ROAD)
    for method in ("reset", "step"):
        with pytest.raises(InputError, match=f"traffic .*:Given: {method} returned .*{message}"):
            getattr(traffic, method)(EGO)


def test_an_object_without_step_is_refused() -> None:
    with pytest.raises(InputError, match=r"traffic builtins:object lacks reset\(ego\) and step"):
        OwnTraffic(object(), ROAD)


def test_a_vehicle_is_placed_on_its_lane() -> None:
    route = RoadMap.builtin().route()
    station = 3_000.0
    vehicle = vehicle_on(route, "a", station, lane=1, shift=0.5, speed=9.0, kind="van")
    assert (vehicle.id, vehicle.lane, vehicle.speed, vehicle.kind) == ("a", 1, 9.0, "van")
    assert vehicle.offset == pytest.approx(float(route.lane_offset(1, station)) + 0.5)
    found_station, found_offset = route.locate(vehicle.x, vehicle.y, station)
    assert (found_station, found_offset) == pytest.approx((station, vehicle.offset), abs=0.01)
    assert vehicle.pitch == pytest.approx(-math.atan(route.evaluate(station, 0.0).grade), abs=1e-3)
    assert vehicle_on(route, "b", station, pitch=0.1).pitch == 0.1
    with pytest.raises(InputError, match="lane 7 does not exist at station 3000 m; there are"):
        vehicle_on(route, "c", station, lane=7)


def test_a_recording_of_it_is_replayed_but_not_run_again() -> None:
    recorder = Recorder(OwnTraffic(Given([CAR]), ROAD))
    recorder.reset(EGO)
    recorder.step(EGO)
    recording = recorder.recording
    assert recording.meta["mode"].endswith("test_own_traffic:Given")
    replay = RepSim(ROAD, recording)
    assert replay.reset() == VehicleFrame.of([CAR])
    with pytest.raises(InputError, match="Given' cannot be re-run; 'iits-mj replay' and RepSim"):
        ReSim(ROAD, recording).reset(EGO)
