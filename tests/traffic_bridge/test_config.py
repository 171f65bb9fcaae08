import dataclasses
import json
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from traffic_bridge import (
    KINDS,
    Departure,
    InterSim,
    PureSim,
    SlowConvoy,
    TrafficConfig,
    VehicleChange,
    default_types,
)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"density": "thick"}, "dense, medium, sparse"),
        ({"density": 0.9}, "0 to 0.5"),
        ({"density": math.nan}, "0 to 0.5"),
        ({"speed_limit": -1.0}, "1 to 70"),
        ({"lane_change": "teleport"}, "lc2013, mobil"),
        ({"lane_discipline": "left"}, "allowed are right, free"),
        ({"mix": {"tank": 1.0}}, "the kinds are"),
        ({"mix": {"car": 0.0}}, "at least positive"),
        ({"view_range": math.inf}, "view_range"),
        ({"density": True}, "0 to 0.5"),
        ({"density": {"car": math.nan}}, "density of car = nan"),
        ({"density": {"tram": 0.1}}, "the kinds are car"),
        ({"mix": 3}, "must be names of types with their weights"),
        ({"mix": (("car",),)}, "must be names of types with their weights"),
        ({"mix": {"car": "much"}}, "zero or positive"),
        ({"types": ()}, "at least one"),
        ({"types": 3}, "must be a sequence of VehicleType"),
        ({"footprint": None}, "footprint None: must be an EgoFootprint"),
        ({"units": [(1.0, 2.0)]}, r"units .*: must be UnitShapes"),
        ({"units": 3}, r"units 3: must be UnitShapes"),
        ({"units": [(0.0, math.nan, 5.0, 2.5)]}, "units: ahead = nan m: allowed is -100 to 100"),
        ({"footprint": "truck"}, "footprint 'truck': must be an EgoFootprint"),
        ({"speed_limit": 10**400}, r"speed_limit = 10+\.\.\.: allowed is 1 to 70"),
        ({"speed_limit": 10**6000}, "allowed is 1 to 70"),
        ({"mix": (([], 1),)}, "must be names of types with their weights"),
        ({"mix": {"car": 10**400}}, "zero or positive"),
        ({"mix": {"car": 1e308, "van": 1e308}}, "zero or positive"),
        ({"scope": []}, "route, both, map"),
    ],
)
def test_unusable_settings_are_refused_with_what_is_allowed(values, text):
    with pytest.raises(InputError, match=text):
        TrafficConfig(**values)


def test_free_lane_discipline_sets_keep_right_terms_and_politeness_of_every_type_to_zero():
    free = TrafficConfig(lane_discipline="free")
    for name in ("keep_right_bias", "lc_keep_right", "politeness"):
        assert {getattr(kind, name) for kind in free.types} == {0.0}
        assert all(getattr(kind, name) > 0.0 for kind in TrafficConfig().types)
    assert dataclasses.replace(free).types == free.types


def test_densities_have_the_papers_probabilities():
    found = [TrafficConfig(density=name).probability for name in ("dense", "medium", "sparse")]
    assert found == [0.05, 0.02, 0.005]


def test_a_configuration_survives_json():
    units = TruckParameters.load().unit_shapes
    mix = {"car": 1.0, "truck": 0.5}
    config = TrafficConfig(density=0.1, mix=mix, lane_change="mobil", units=units)
    assert config.units == units
    assert TrafficConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config


def test_a_configuration_with_numbers_of_numpy_is_stored_as_json():
    config = TrafficConfig(
        density={"car": np.float32(0.25), "truck": np.float64(0.125)},
        speed_limit=np.float32(15),
        view_range=np.int64(200),
        footprint=EgoFootprint(length=np.float32(12)),
        types=[dataclasses.replace(kind, height=np.float32(2)) for kind in default_types()],
        departures=[Departure(time=np.float32(3), lane=np.int64(1), speed=np.float32(9))],
        events=[
            SlowConvoy(station=np.float32(100), speed=np.float32(5), count=np.int8(2)),
            VehicleChange(
                target="car",
                parameters={"time_headway": np.float32(2), "color": [np.float32(1), 0, 0]},
            ),
        ],
    )
    assert config.probability == 0.375
    stored = json.loads(json.dumps(config.as_dict()))
    assert TrafficConfig.from_dict(stored) == config
    assert stored["speed_limit"] == 15.0
    assert stored["departures"][0]["lane"] == 1
    for seed in (np.int64(3), np.uint8(3)):
        traffic = PureSim(Route.straight(length=1000.0), config, seed)
        assert type(traffic.seed) is int


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"length": math.nan}, "footprint: length = nan m: allowed is 1 to 100"),
        ({"length": -5.0}, "length = -5.0 m"),
        ({"width": 50.0}, "width = 50.0 m: allowed is 0.5 to 10"),
        ({"height": "high"}, "height = 'high' m"),
        ({"length": None}, "length = None m"),
        ({"width": True}, "width = True m"),
        ({"front_overhang": 17.0}, r"front_overhang = 17\.0 m: allowed is 0 to 16\.5"),
    ],
)
def test_a_truck_of_impossible_size_is_refused(values, text):
    with pytest.raises(InputError, match=text):
        EgoFootprint(**values)


def test_a_simulation_without_a_route_a_configuration_or_a_valid_seed_is_refused():
    route = Route.straight(length=1000.0)
    with pytest.raises(InputError, match="PureSim needs a TrafficConfig, not 'medium'"):
        PureSim(route, "medium")
    with pytest.raises(InputError, match=r"not a RoadMap: give road_map\.route\(\)"):
        PureSim(route.road_map)
    with pytest.raises(InputError, match="InterSim needs a Route, not None"):
        InterSim(None)
    for seed in (10**6000, np.True_, 1.0):
        with pytest.raises(InputError, match="a whole number from 0 to 2147483647"):
            PureSim(route, seed=seed)


def test_a_damaged_stored_configuration_is_refused():
    with pytest.raises(InputError, match="not usable"):
        TrafficConfig.from_dict({"density": "dense"})


def test_desired_speeds_stay_below_the_maximum_and_heavy_vehicles_are_slower():
    rng = np.random.default_rng(0)
    means = {}
    for kind in default_types():
        speeds = [kind.sample_desired_speed(15.0, rng) for _ in range(500)]
        assert max(speeds) <= 15.0
        assert min(speeds) >= 15.0 * kind.desired_speed_low
        means[kind.kind] = np.mean(speeds)
    assert set(means) == set(KINDS)
    assert means["articulated"] < means["truck"] < means["van"] < means["car"]
