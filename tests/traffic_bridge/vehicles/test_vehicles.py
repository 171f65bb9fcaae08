import dataclasses
import json

import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge import (
    KINDS,
    LaneClosure,
    PureSim,
    SpeedLimit,
    StoppedVehicle,
    TrafficConfig,
    VehicleType,
    default_types,
    read_types,
)
from traffic_bridge.modes.sumo_traffic import SumoTraffic
from traffic_bridge.overrides import Overrides

TYPES = {kind.name: kind for kind in default_types()}


@pytest.fixture(scope="module")
def road():
    return Route.straight(length=1500.0)


def test_a_custom_type_has_its_own_parameters_and_the_kind_of_its_look(road):
    tanker = dataclasses.replace(TYPES["articulated"], name="tanker", length=14.0, politeness=1.0)
    config = TrafficConfig(density=0.1, types=(TYPES["car"], tanker), mix={"car": 1, "tanker": 1})
    with PureSim(road, config, seed=1) as traffic:
        vehicles = traffic.reset()
        tankers = [v for v in vehicles if v.id.startswith("tanker")]
        assert tankers
        assert {(v.kind, v.length) for v in tankers} == {("articulated", 14.0)}
        assert traffic.vehicles.type_of(tankers[0].id).politeness == 1.0
    assert TrafficConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config


def test_probabilities_by_type_are_the_density_and_the_mix(road):
    config = TrafficConfig(density={"car": 0.04, "truck": 0.01})
    assert config.probability == pytest.approx(0.05)
    assert config.mix == (("car", 0.04), ("truck", 0.01))
    with PureSim(road, dataclasses.replace(config, density=0.2), seed=1) as traffic:
        vehicles = traffic.reset()
    trucks = sum(v.kind == "truck" for v in vehicles)
    assert {v.kind for v in vehicles} == {"car", "truck"}
    assert 0 < trucks < 0.5 * len(vehicles)


def test_every_vehicle_has_one_constant_color_of_its_type():
    car = TYPES["car"]
    names = [f"car.{k:05d}" for k in range(200)]
    found = [car.color_of(name) for name in names]
    assert set(found) == set(car.colors)
    assert found == [car.color_of(name) for name in names]


def test_changed_parameters_of_one_vehicle_are_read_back_from_sumo(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        name, other = [v.id for v in traffic.reset() if v.kind == "car"][:2]
        former = traffic.vehicles.in_force(other)
        values = {
            "time_headway": 2.2,
            "minimum_gap": 3.3,
            "acceleration": 0.8,
            "deceleration": 1.9,
            "emergency_deceleration": 7.0,
            "desired_speed": 9.0,
            "politeness": 0.6,
            "change_threshold": 0.4,
            "keep_right_bias": 0.1,
            "safe_braking": 2.5,
            "lc_strategic": 2.0,
            "lc_cooperative": 0.5,
            "lc_speed_gain": 3.0,
            "lc_keep_right": 0.0,
            "lc_assertive": 1.5,
            "color": (0.1, 0.2, 0.3),
        }
        undo = traffic.vehicles.change(name, **values)
        found = traffic.vehicles.in_force(name)
        assert found.pop("color") == values.pop("color")
        assert found == pytest.approx(values)
        assert traffic.vehicles.in_force(other) == former
        before = TrafficConfig().type_of("car")
        undo()
        assert traffic.vehicles.type_of(name) == before


def test_a_changed_type_holds_for_later_vehicles(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        there = {v.id for v in traffic.reset()}
        undo = traffic.vehicles.change(
            "car", desired_speed=8.0, time_headway=2.0, lc_speed_gain=0.2, color=(1.0, 0.0, 0.0)
        )
        for _ in range(150):
            vehicles = traffic.step()
        new = [v.id for v in vehicles if v.kind == "car" and v.id not in there]
        assert new
        for name in new:
            found = traffic.vehicles.in_force(name)
            assert found["desired_speed"] == 8.0
            assert found["time_headway"] == 2.0
            assert found["lc_speed_gain"] == pytest.approx(0.2)
            assert found["color"] == (1.0, 0.0, 0.0)
        undo()
        for _ in range(150):
            vehicles = traffic.step()
        for v in vehicles:
            if v.kind == "car":
                found = traffic.vehicles.in_force(v.id)
                assert found["time_headway"] == 1.5
                assert found["lc_speed_gain"] == 1.0
                assert found["color"] in TYPES["car"].colors
                assert found["desired_speed"] > 8.0


def test_a_type_can_be_changed_while_some_of_its_vehicles_cannot_depart(road):
    # A queue covers the entrance: SUMO drops vehicles that cannot depart for some seconds.
    config = TrafficConfig(
        density=0.5, events=tuple(StoppedVehicle(station=60.0, lane=k) for k in range(3))
    )
    with PureSim(road, config, seed=1) as traffic:
        traffic.reset()
        for _ in range(400):
            traffic.step()
        traffic.vehicles.change("car", time_headway=1.0)
        vehicles = traffic.step()
        assert all(
            traffic.vehicles.in_force(v.id)["time_headway"] == 1.0
            for v in vehicles
            if v.kind == "car" and not v.id.startswith("stopped")
        )


@pytest.mark.parametrize(
    ("target", "values", "text"),
    [
        ("car", {"mood": 1.0}, "parameter 'mood': allowed are time_headway"),
        ("car", {"time_headway": 0.0}, "car.time_headway = 0.0: must be positive"),
        ("car", {"politeness": float("nan")}, "must be finite"),
        ("car", {"politeness": True}, "must be finite"),
        ("car", {"color": (2.0, 0.0, 0.0)}, "each from 0 to 1"),
        ("car", {}, "no parameter of car"),
        ("ghost.1", {"politeness": 1.0}, "no vehicle 'ghost.1'"),
    ],
)
def test_unusable_changes_are_refused(target, values, text, road):
    with PureSim(road, TrafficConfig(density=0.05), seed=1) as traffic:
        traffic.reset()
        with pytest.raises(InputError, match=text):
            traffic.vehicles.change(target, **values)
        traffic.step()


def test_types_of_a_file_override_the_types_of_the_package(tmp_path):
    path = tmp_path / "types.toml"
    path.write_text(
        """
        [car]
        time_headway = 1.1

        [taxi]
        like = "car"
        colors = [[0.9, 0.7, 0.1]]

        [tanker]
        look = "articulated"
        length = 14.0
        """,
        encoding="utf-8",
    )
    types = {kind.name: kind for kind in read_types(path)}
    assert tuple(types) == (*KINDS, "taxi", "tanker")
    assert types["car"] == dataclasses.replace(TYPES["car"], time_headway=1.1)
    assert types["taxi"] == dataclasses.replace(
        types["car"], name="taxi", colors=((0.9, 0.7, 0.1),)
    )
    assert types["tanker"] == dataclasses.replace(TYPES["articulated"], name="tanker", length=14.0)
    assert types["van"] == TYPES["van"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[car]\nmood = 1", "car.mood is unknown; the fields are"),
        ("[car]\ntime_headway = -1", "time_headway = -1: must be zero or positive"),
        ("[car]\ntime_headway = nan", "time_headway = nan"),
        ("[car]\ncolors = [[1, 2]]", "must be red, green, blue"),
        ("[taxi]\nlength = 4.0", "there is no type 'taxi' to start from"),
        ("[bus]\nlike = []", r"there is no type \[\] to start from"),
        ("car = 3", "expected a table"),
        ("[car", "not TOML"),
        ("[ego]\nlike = 'car'", "vehicle type 'ego'"),
    ],
)
def test_unusable_type_files_are_refused_by_name(tmp_path, text, reason):
    path = tmp_path / "types.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=reason) as caught:
        read_types(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"name": "x y"}, "vehicle type 'x y': a name has"),
        ({"name": "tram", "look": ""}, "look 'tram': allowed are car"),
        ({"length": float("inf")}, "car.length = inf"),
        ({"lc_assertive": 0.0}, "lc_assertive = 0.0: must be positive"),
        ({"colors": ()}, "at least one color"),
    ],
)
def test_unusable_types_are_refused(values, text):
    with pytest.raises(InputError, match=text):
        dataclasses.replace(TYPES["car"], **values)


def test_two_types_of_one_name_are_refused():
    with pytest.raises(InputError, match="each with a name of its own"):
        TrafficConfig(types=(TYPES["car"], TYPES["car"]), mix={"car": 1.0})


def test_only_lane_change_parameters_unlike_the_defaults_of_sumo_are_written():
    assert "lcSpeedGain" not in TYPES["car"].to_sumo_xml(15.0)
    eager = dataclasses.replace(TYPES["car"], lc_speed_gain=2.0)
    assert 'lcSpeedGain="2.0"' in eager.to_sumo_xml(15.0)


def test_a_vehicle_type_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        TYPES["car"].length = 3.0
    assert isinstance(TYPES["car"], VehicleType)


def in_force(traffic, name, field):
    return traffic.vehicles.in_force(name)[field]


@pytest.mark.parametrize("first_ended", [0, 1])
@pytest.mark.parametrize("target", ["car", "one"])
def test_the_newer_of_two_changes_holds_and_undoing_both_restores_the_original(
    road, target, first_ended
):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        name = next(v.id for v in traffic.reset() if v.kind == "car")
        target = name if target == "one" else target
        speed = in_force(traffic, name, "desired_speed")
        undo = [
            traffic.vehicles.change(target, time_headway=2.0, desired_speed=9.0),
            traffic.vehicles.change(target, time_headway=4.0),
        ]
        assert in_force(traffic, name, "time_headway") == 4.0
        undo[first_ended]()
        assert in_force(traffic, name, "time_headway") == (4.0, 2.0)[first_ended]
        undo[1 - first_ended]()
        undo[1 - first_ended]()
        assert in_force(traffic, name, "time_headway") == 1.5
        assert in_force(traffic, name, "desired_speed") == pytest.approx(speed)
        assert traffic.vehicles.type_of(name) == TrafficConfig().type_of("car")
        assert traffic.vehicles.types() == TrafficConfig().types


def test_changes_of_a_vehicle_and_of_its_type_end_independently(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        one, other = [v.id for v in traffic.reset() if v.kind == "car"][:2]
        change = traffic.vehicles.change

        def headways():
            return tuple(in_force(traffic, name, "time_headway") for name in (one, other))

        own = change(one, time_headway=2.0, color=(1.0, 0.0, 0.0))
        of_class = change("car", time_headway=4.0, color=(0.0, 0.0, 1.0))
        assert headways() == (4.0, 4.0)
        of_class()
        assert headways() == (2.0, 1.5)
        assert traffic.vehicles.color(one) == (1.0, 0.0, 0.0)
        of_class = change("car", time_headway=3.0)
        newest = change(one, time_headway=5.0)
        own()
        assert headways() == (5.0, 3.0)
        of_class()
        assert headways() == (5.0, 1.5)
        newest()
        assert headways() == (1.5, 1.5)
        assert traffic.vehicles.color(one) in TYPES["car"].colors


def test_repeated_permanent_changes_of_a_vehicle_take_no_more_memory(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        name = next(v.id for v in traffic.reset() if v.kind == "car")
        undo = traffic.vehicles.change(name, time_headway=2.0)
        for _ in range(200):
            traffic.vehicles.change(name, time_headway=3.0)
        undo()
        assert in_force(traffic, name, "time_headway") == 3.0
    overrides = Overrides()
    kept = overrides.add("a", {"time_headway": 2.0}, list)
    for _ in range(200):
        overrides.add("a", {"time_headway": 3.0}, list)
    assert len(overrides) < 4
    kept()
    assert overrides.newest("time_headway", "a") == 3.0


def test_vehicles_that_cannot_depart_at_a_full_entrance_are_dropped(road):
    config = TrafficConfig(
        density=0.5, events=tuple(StoppedVehicle(station=60.0, lane=k) for k in range(3))
    )
    with PureSim(road, config, seed=1) as traffic:
        traffic.reset()
        for _ in range(600):
            traffic.step()
        api = traffic.session.api
        there = {*api.vehicle.getIDList(), *api.simulation.getPendingVehicles()}
        # 1.5 vehicles a second arrive, and each is stored for at most 5 s.
        assert len(traffic.vehicles.names() - there) < 15


def test_data_of_a_vehicle_that_an_event_removes_are_dropped(road):
    closure = LaneClosure(lane=0, start=500.0, end=900.0, at_time=0.1, until=1.0)
    config = TrafficConfig(density="empty", events=(closure,))
    world = SumoTraffic(road, config, seed=1, with_ego=False)
    try:
        forgotten = []
        world.begin(None)
        world.vehicles.when_forgotten(forgotten.append)
        trucks = {v.id for _ in range(9) for v in world.advance(None)}
        assert world.observation.names() == trucks != set()
        for _ in range(9):
            world.advance(None)
        assert sorted(forgotten) == sorted(trucks)
        assert not world.observation.names()
    finally:
        world.close()


def test_a_speed_limit_keeps_no_data_of_vehicles_that_have_left(road):
    config = TrafficConfig(density=0.2, events=(SpeedLimit(limit=9.0, start=1400.0),))
    with PureSim(road, config, seed=1) as traffic:
        traffic.reset()
        for _ in range(300):
            traffic.step()
        assert traffic.vehicles.limited() <= traffic.vehicles.names()
