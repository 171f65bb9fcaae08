import json
import math

import numpy as np
import pytest

from iits_mj.errors import InputError
from traffic_bridge import KINDS, TrafficConfig, default_types


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"density": "thick"}, "dense, medium, sparse"),
        ({"density": 0.9}, "0 to 0.5"),
        ({"density": math.nan}, "0 to 0.5"),
        ({"speed_limit": -1.0}, "1 to 70"),
        ({"lane_change": "teleport"}, "lc2013, mobil"),
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
    ],
)
def test_unusable_settings_are_refused_with_what_is_allowed(values, text):
    with pytest.raises(InputError, match=text):
        TrafficConfig(**values)


def test_densities_have_the_papers_probabilities():
    found = [TrafficConfig(density=name).probability for name in ("dense", "medium", "sparse")]
    assert found == [0.05, 0.02, 0.005]


def test_a_configuration_survives_json():
    config = TrafficConfig(density=0.1, mix={"car": 1.0, "truck": 0.5}, lane_change="mobil")
    assert TrafficConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config


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
