"""The user's own parts in the stack: used, counted, and refused where their results do not fit."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from controllers import decision
from controllers.own_parts import (
    DecisionGuard,
    LateralGuard,
    LongitudinalGuard,
    PlannerGuard,
    SpeedGuard,
)
from controllers.planning.planner import Planner, PlannerConfig
from controllers.planning.speed_reference import CruiseReference
from controllers.protocols import (
    DecisionMaker,
    LateralControl,
    LongitudinalControl,
    SpeedSource,
    TrajectoryPlanner,
)
from controllers.stack import Stack
from controllers.tracking.lateral import LateralController
from controllers.tracking.longitudinal import LongitudinalController
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    PlanMode,
    Scene,
    SpeedProfile,
    Trajectory,
    VehicleCommand,
    XbrMode,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route

ROAD = Route.straight(length=2_000.0, lanes=2)
EGO = EgoState(station=300.0, x=300.0, offset=float(ROAD.lane_offset(0, 300.0)), speed=15.0)
SCENE = Scene(0.0, EGO)


class Part:
    """Any part: every method returns what it was made with."""

    def __init__(self, value: Any = None) -> None:
        self.value, self.resets = value, 0

    def reset(self) -> None:
        self.resets += 1

    def decide(self, context: Any) -> Any:
        return self.value

    def plan(self, scene: Scene, decision: Decision, profile: SpeedProfile) -> Any:
        return self.value(scene) if callable(self.value) else self.value

    def steer(self, ego: EgoState, trajectory: Trajectory) -> Any:
        return self.value

    def command(self, ego: EgoState, trajectory: Trajectory, grade: float) -> Any:
        return self.value

    def update(self, scene: Scene, find_leader: Any) -> Any:
        return self.value


def straight(scene: Scene, **changes: Any) -> Trajectory:
    time = scene.time + np.array([0.0, 1.0, 2.0])
    station = scene.ego.station + 15.0 * (time - scene.time)
    none, speed = np.zeros(3), np.full(3, 15.0)
    plan = Trajectory(
        time=time,
        station=station,
        offset=np.full(3, scene.ego.offset),
        x=station,
        y=none,
        z=none,
        yaw=none,
        curvature=none,
        speed=speed,
        acceleration=none,
    )
    return dataclasses.replace(plan, **changes)


def stack(**parts: Any) -> Stack:
    return Stack(ROAD, **parts)


def test_shipped_parts_are_used_without_a_guard() -> None:
    made = Stack(
        ROAD,
        decision.make("mobil"),
        reference=CruiseReference(10.0),
        trajectory_planner=Planner(ROAD),
    )
    assert type(made.planner) is Planner
    assert type(made.reference) is CruiseReference
    assert isinstance(made.tracker.lateral, LateralController)
    assert isinstance(made.tracker.longitudinal, LongitudinalController)
    assert "Guard" not in type(made.decision_maker).__name__


def test_shipped_parts_fit_their_protocols() -> None:
    parameters = TruckParameters.load()
    assert isinstance(decision.make("keep"), DecisionMaker)
    assert isinstance(Planner(ROAD), TrajectoryPlanner)
    assert isinstance(LateralController(parameters), LateralControl)
    assert isinstance(LongitudinalController(parameters), LongitudinalControl)
    assert isinstance(CruiseReference(10.0), SpeedSource)


def test_own_parts_are_reset_with_the_stack_and_get_their_turn() -> None:
    profile = SpeedProfile(np.array([0.0, 2e3]), np.array([9.0, 9.0]))
    parts = {
        "decision_maker": Part(1),
        "trajectory_planner": Part(straight),
        "lateral": Part(0.25),
        "longitudinal": Part(VehicleCommand(accelerator_pedal=0.5, steering_wheel_angle=9.0)),
        "reference": Part(profile),
    }
    made = stack(**parts)
    assert [part.resets for part in parts.values()] == [1] * 5
    plan = made.plan(SCENE)
    assert plan.speed.tolist() == [15.0] * 3
    assert made.last_decision is Decision.RIGHT
    assert made.reference_speed(500.0) == 9.0
    # The steering is the lateral controller's.
    wanted = VehicleCommand(accelerator_pedal=0.5, steering_wheel_angle=0.25)
    assert made.control(EGO) == wanted
    made.reset()
    assert [part.resets for part in parts.values()] == [2] * 5


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("decision_maker", r"decision maker builtins:object lacks reset\(\) and decide\(context\)"),
        ("trajectory_planner", r"planner .* lacks reset.* and plan\(scene, decision, profile\)"),
        ("lateral", r"lateral controller .* lacks .*steer\(ego, trajectory\)"),
        ("longitudinal", r"longitudinal controller .*command\(ego, trajectory, grade\)"),
        ("reference", r"speed planner .*update\(scene, find_leader\)"),
    ],
)
def test_an_object_without_the_methods_is_refused(option: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        stack(**{option: object()})


def test_a_wrong_decision_is_refused_with_the_name_of_the_part() -> None:
    for value in ("left", 2, None, 0.5):
        with pytest.raises(InputError, match=r"decision maker .*:Part: decision is .*allowed"):
            stack(decision_maker=Part(value)).plan(SCENE)


class Slow(Part):
    """Keeps its lane, and allows a highest speed [m/s] in its first decision alone."""

    speed_max: Any = math.inf

    def decide(self, context: Any) -> Decision:
        self.speed_max = self.value if context.scene.time == 0.0 else math.inf
        return Decision.KEEP


def test_a_decision_maker_may_allow_a_highest_speed_until_its_next_decision() -> None:
    made = stack(decision_maker=Slow(10.0))
    ends = [
        made.plan(dataclasses.replace(SCENE, time=0.1 * cycle)).speed[-1] for cycle in range(11)
    ]
    # A plan brakes for some seconds: it ends nearer to 10 m/s than to the set speed of 16.67 m/s.
    assert max(ends[:10]) < 12.5
    assert ends[10] > 14.0
    assert made.context(SCENE).reference_speed == made.reference_speed(300.0)
    made.plan(dataclasses.replace(SCENE, time=9.0))
    made.reset()
    assert made.speed_max == math.inf


@pytest.mark.parametrize("value", [math.nan, 0.0, -1.0, "10", None, True])
def test_a_highest_speed_that_is_none_is_refused_with_the_name_of_the_part(value: Any) -> None:
    with pytest.raises(InputError, match=r"decision maker .*Slow.*: speed_max is .*0\.5 m/s"):
        stack(decision_maker=Slow(value)).plan(SCENE)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "returned None, must return a Trajectory"),
        ({"speed": [15.0, math.nan, 15.0]}, r"returned speed\[1\] = nan: not finite"),
        ({"x": [0.0, 1.0]}, r"returned x of shape \(2,\), time of \(3,\)"),
        ({"yaw": np.zeros((3, 1))}, r"returned yaw of shape \(3, 1\)"),
        ({"offset": ["a", "b", "c"]}, "returned no numbers as offset"),
        ({"time": np.array([0.0, 2.0, 1.0])}, "times 0 to 1 s at 0 s: they must rise"),
        ({"time": np.array([-3.0, -2.0, -1.0])}, "and end later"),
        ({"station": np.array([9.0, 8.0, 7.0])}, "stations that fall"),
        ({"speed": np.full(3, -1.0)}, "speeds below zero"),
        ({"mode": "keep"}, "mode 'keep', target_lane 0"),
        ({"target_lane": 0.5}, "target_lane 0.5"),
    ],
)
def test_a_wrong_plan_is_refused(value: Any, message: str) -> None:
    plan = straight(SCENE, **value) if isinstance(value, dict) else value
    with pytest.raises(InputError, match=f"planner .*:Part: plan .*{message}"):
        stack(trajectory_planner=Part(plan)).plan(SCENE)


def test_lists_are_arrays_of_a_plan() -> None:
    plan = stack(trajectory_planner=Part(straight(SCENE, z=[0, 0, 0]))).plan(SCENE)
    assert plan.z.dtype == float


@pytest.mark.parametrize("value", [math.nan, None, math.inf, np.array([0.1, 0.2])])
def test_a_steering_angle_that_is_no_finite_number_is_refused(value: Any) -> None:
    made = stack(lateral=Part(value))
    made.plan(SCENE)
    with pytest.raises(InputError, match=r"lateral controller .*:Part: steer returned"):
        made.control(EGO)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.3, "returned 0.3, must be a VehicleCommand"),
        (VehicleCommand(accelerator_pedal=math.nan), "returned accelerator_pedal = nan"),
        (VehicleCommand(accelerator_pedal=1.5), "= 1.5: allowed is 0 to 1"),
        (VehicleCommand(xbr_demand=1.0), "xbr_demand = 1.0: allowed is -20 to 0"),
        (VehicleCommand(xbr_mode=7), "xbr_mode 7: not a mode"),  # type: ignore[arg-type]
    ],
)
def test_a_wrong_command_is_refused(value: Any, message: str) -> None:
    made = stack(longitudinal=Part(value))
    made.plan(SCENE)
    with pytest.raises(InputError, match=f"longitudinal controller .*:Part: command .*{message}"):
        made.control(EGO)


def test_modes_of_a_command_may_be_numbers() -> None:
    number = VehicleCommand(xbr_demand=-1.0, xbr_mode=2)  # type: ignore[arg-type]
    made = stack(longitudinal=Part(number))
    made.plan(SCENE)
    assert made.control(EGO).xbr_mode is XbrMode.MAXIMUM


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (12.0, "update returned 12.0, must be a SpeedProfile"),
        (SpeedProfile(np.zeros(1), np.ones(1)), "two rows or more"),
        (SpeedProfile(np.array([0.0, 1.0]), np.array([math.nan, 9.0])), "not finite"),
        (SpeedProfile(np.array([1.0, 0.0]), np.array([9.0, 9.0])), "stations must rise"),
        (SpeedProfile("ab", "cd"), "without numbers"),  # type: ignore[arg-type]
    ],
)
def test_a_wrong_speed_profile_is_refused(value: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"speed planner .*:Part.*{message}"):
        stack(reference=Part(value)).plan(SCENE)


def test_the_speed_without_traffic_is_the_profiles_unless_the_part_gives_it() -> None:
    profile = SpeedProfile([0.0, 1e3], [9.0, 9.0])  # type: ignore[arg-type]
    part = Part(profile)
    guard = SpeedGuard(part)
    guard.update(SCENE, lambda: None)
    assert guard.free(10.0) == guard.at(10.0) == 9.0
    part.free = lambda station: 20.0  # type: ignore[attr-defined]
    assert guard.free(10.0) == 20.0
    guard.reset()
    with pytest.raises(InputError, match="was not called yet"):
        guard.at(10.0)


def test_an_own_planner_counts_what_its_plans_say() -> None:
    modes = [
        {"target_lane": 0},
        {"target_lane": 1, "mode": PlanMode.LANE_CHANGE},
        {"target_lane": 1},
        {"target_lane": 1, "refused": Decision.LEFT},
        {"target_lane": 1, "mode": PlanMode.EMERGENCY},
        {"target_lane": 1, "mode": PlanMode.EMERGENCY},
    ]
    left = iter(modes)
    made = stack(trajectory_planner=Part(lambda scene: straight(scene, **next(left))))
    seen = []
    for number in range(len(modes)):
        asks = made.asks_at(number)
        made.plan(dataclasses.replace(SCENE, time=float(number)))
        seen.append((asks, made.planner.changing, made.lane_changes, made.refused))
    # No decision while the lane is changed.
    assert seen[:4] == [
        (True, False, 0, 0),
        (True, True, 0, 0),
        (False, False, 1, 0),
        (True, False, 1, 1),
    ]
    assert (made.planner.emergencies, made.unsafe) == (1, 0)
    assert made.planner.lane(SCENE) == 1


def test_a_planner_derived_from_the_shipped_one_reports_its_own_counts() -> None:
    class Derived(Planner):
        pass

    own = stack(trajectory_planner=Derived(ROAD, PlannerConfig()))
    shipped = stack()
    assert isinstance(own.planner, PlannerGuard)
    for number in range(3):
        scene = dataclasses.replace(SCENE, time=0.1 * number)
        assert own.plan(scene).speed.tobytes() == shipped.plan(scene).speed.tobytes()
    assert own.lane_changes == shipped.lane_changes == 0
    assert own.refused == shipped.refused


def test_every_kind_of_own_part_is_behind_its_guard() -> None:
    profile = SpeedProfile([0.0, 1e3], [9.0, 9.0])  # type: ignore[arg-type]
    made = stack(
        decision_maker=Part(0),
        trajectory_planner=Part(straight),
        lateral=Part(0.0),
        longitudinal=Part(VehicleCommand()),
        reference=Part(profile),
    )
    kinds = (DecisionGuard, PlannerGuard, LateralGuard, LongitudinalGuard, SpeedGuard)
    tracker = made.tracker
    parts = (
        *(made.decision_maker, made.planner, tracker.lateral, tracker.longitudinal),
        made.reference,
    )
    assert tuple(map(type, parts)) == kinds
