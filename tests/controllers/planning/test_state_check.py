"""Invalid scenes, settings and decisions are refused by name."""

import dataclasses
import math

import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.planner import Planner
from controllers.stack import Stack
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.road import Route
from tests.controllers.scenes import car

ROAD = Route.straight(length=3000.0, lanes=2)
EGO = EgoState(
    station=500.0, offset=float(ROAD.lane_offset(0, 500.0)), speed=16.0, acceleration=0.0, mass=55e3
)


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["acceleration", "speed", "station", "width", "yaw", "yaw_rate"])
def test_a_vehicle_with_a_value_that_is_not_finite_is_refused(name, value):
    vehicle = dataclasses.replace(car(ROAD, "leader", 560.0, 0, 5.0), **{name: value})
    with pytest.raises(InputError, match=f"'leader': {name}"):
        Planner(ROAD).plan(Scene(0.0, EGO, (vehicle,)))


@pytest.mark.parametrize(
    ("name", "value"),
    [("step", 0.0), ("horizon", -1.0), ("step", math.nan), ("horizon", 0.01), ("curve_share", 0.0)],
)
def test_invalid_settings_of_the_planner_are_named(name, value):
    with pytest.raises(InputError, match=f"PlannerConfig: {name}"):
        PlannerConfig(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("cruise_speed", -5.0), ("cruise_speed", math.nan), ("preview", 0.0), ("stop_gap", -1.0)],
)
def test_invalid_settings_of_the_speed_are_named(name, value):
    with pytest.raises(InputError, match=f"SpeedConfig: {name}"):
        SpeedConfig(**{name: value})


@pytest.mark.parametrize("decision", [7, "left", None, True])
def test_values_that_are_no_decisions_are_refused(decision):
    with pytest.raises(InputError, match="decision is"):
        Planner(ROAD).plan(Scene(0.0, EGO), decision)

    class Maker:
        def reset(self):
            pass

        def decide(self, context):
            return decision

    with pytest.raises(InputError, match="decision is"):
        Stack(ROAD, decision_maker=Maker()).plan(Scene(0.0, EGO))


def test_the_number_of_a_decision_is_accepted():
    assert Planner(ROAD).plan(Scene(0.0, EGO), -1).target_lane == 1
    assert Planner(ROAD).plan(Scene(0.0, EGO), Decision.KEEP).target_lane == 0


@pytest.mark.parametrize(
    ("name", "value"), [("mass", 1.0), ("mass", 1e9), ("station", -50.0), ("station", 5000.0)]
)
def test_a_truck_off_its_road_or_with_an_impossible_mass_is_refused(name, value):
    with pytest.raises(InputError, match=f"state of the truck: {name}"):
        Planner(ROAD).plan(Scene(0.0, dataclasses.replace(EGO, **{name: value})))
