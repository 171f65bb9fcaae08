"""Parts of the planner one by one: lanes, stops, caps, references, poses, margins, leaders."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.following import Lead
from controllers.planning.lane_change import Change, LaneChoice
from controllers.planning.planner import Planner, named_decision
from controllers.planning.predicted_boxes import Poses
from controllers.planning.road_preview import RoadPreview, lane_shift, road_curvature
from controllers.planning.rollover_limits import (
    RollMargins,
    rearward_amplification,
    roll_threshold,
)
from controllers.planning.speed_caps import LAUNCH_ACCELERATION, SpeedCaps, _reference
from controllers.planning.speed_plan import SpeedState, most_urgent, power_acceleration
from controllers.planning.speed_reference import CruiseReference, check_covers, check_profile
from controllers.planning.stopped_vehicle import StoppedLeader, stopped_leader
from controllers.planning.stops import LightDemand, Stops
from controllers.planning.tight_bend_yield import DECELERATION, TightBends
from controllers.planning.trajectory import Quintic
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    LightState,
    PlanMode,
    RoadSignals,
    Scene,
    SpeedProfile,
    SpeedZone,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.planning.test_crossing import bend
from tests.controllers.planning.test_tight_bend_yield import oncoming
from tests.controllers.scenes import advanced, car

PARAMETERS = TruckParameters.load()
CONFIG = PlannerConfig()
ROUTE = Route.straight(length=3_000.0, lanes=2, speed_limit=25.0)
PREVIEW = RoadPreview(ROUTE)
MARGINS = RollMargins(PARAMETERS, 1.0 / CONFIG.change.duration_min)


def ego(station=1000.0, speed=15.0, lane=0, **fields):
    offset = float(ROUTE.lane_offset(lane, station))
    return EgoState(station=station, offset=offset, speed=speed, mass=30_000.0, **fields)


def path_of(lane=0, station=1000.0):
    return PREVIEW.follow(lane, station, 400.0, 150.0)


# --- lanes ----------------------------------------------------------------------------------


def choice(config=CONFIG, preview=PREVIEW):
    return LaneChoice(preview, config)


def test_the_left_lane_is_tried_first_and_only_lanes_that_the_truck_may_use():
    lanes = choice()
    assert lanes.around(ego(), path_of(0)) is Decision.LEFT
    assert lanes.around(ego(), path_of(1)) is Decision.RIGHT
    only = choice(dataclasses.replace(CONFIG, lanes=(0,)))
    assert only.around(ego(), path_of(0)) is Decision.KEEP


def test_the_path_of_a_lane_is_kept_until_the_truck_reaches_the_next_row():
    lanes = choice()
    first = lanes.follow(0, ego(1000.0))
    assert lanes.follow(0, ego(1002.0)) is first
    assert lanes.follow(1, ego(1002.0)) is not first
    assert lanes.follow(0, ego(1006.0)) is not first


@pytest.mark.parametrize(("station", "wanted"), [(390.0, Decision.KEEP), (410.0, Decision.LEFT)])
def test_a_lane_that_ends_within_the_merge_time_must_be_left(station, wanted):
    # The cruise speed of 16.67 m/s over 24 s are 400 m, more than 300 m.
    lanes, truck = choice(), ego(station, 5.0)
    path = dataclasses.replace(lanes.follow(0, truck), end=800.0)
    assert lanes.mandatory(truck, path) is wanted
    path = dataclasses.replace(path, end=station + 599.0)
    assert lanes.mandatory(ego(station, 25.0), path) is Decision.LEFT
    assert lanes.mandatory(ego(station, 24.9), path) is Decision.KEEP


def test_a_lane_that_ends_with_the_road_is_not_left():
    lanes, truck = choice(), ego(2800.0)
    assert lanes.mandatory(truck, lanes.follow(0, truck)) is Decision.KEEP


ARGUMENTS = {"forced": False, "passing": False, "since": 99.0, "finding": False}


@pytest.mark.parametrize(
    ("truck", "wanted", "change", "reason"),
    [
        (ego(), Decision.LEFT, {}, ""),
        (ego(), Decision.RIGHT, {}, "there is no lane to the right"),
        (ego(speed=3.9), Decision.LEFT, {}, "speed 3.9 m/s is below 4 m/s"),
        (ego(speed=4.0), Decision.LEFT, {}, ""),
        (ego(speed=3.9), Decision.LEFT, {"passing": True}, ""),
        (ego(speed=3.9), Decision.LEFT, {"forced": True}, ""),
        (ego(), Decision.LEFT, {"finding": True}, "the truck is still finding its lane"),
        (ego(), Decision.LEFT, {"finding": True, "passing": True}, ""),
        (ego(), Decision.LEFT, {"since": 2.9}, "the last change was 2.9 s ago, 3 s must pass"),
        (ego(), Decision.LEFT, {"since": 3.0}, ""),
        (ego(), Decision.LEFT, {"since": 2.9, "forced": True}, ""),
        (ego(2764.0), Decision.LEFT, {}, ""),
        (ego(2766.0), Decision.LEFT, {}, "the lane ends in 234 m, 235 m are needed"),
        (ego(2820.0, 8.0), Decision.LEFT, {}, "the lane ends in 180 m, 190 m are needed"),
        (ego(2766.0), Decision.LEFT, {"forced": True}, ""),
    ],
)
def test_a_change_needs_a_lane_speed_time_and_length(truck, wanted, change, reason):
    lanes = choice()
    _, found = lanes.target(truck, lanes.follow(0, truck), wanted, **(ARGUMENTS | change))
    assert found == reason


def test_a_lane_that_the_truck_may_not_use_is_refused_unless_forced():
    lanes = choice(dataclasses.replace(CONFIG, lanes=(0,)))
    path = lanes.follow(0, ego())
    target, why = lanes.target(ego(), path, Decision.LEFT, **ARGUMENTS)
    assert (target, why) == (None, "lane 1 is not one the truck may use")
    target, why = lanes.target(ego(), path, Decision.LEFT, **(ARGUMENTS | {"forced": True}))
    assert (target.lane, why) == (1, "")


# --- road -----------------------------------------------------------------------------------


def test_the_preview_has_rows_of_5_m_and_finds_the_nearest_one():
    assert PREVIEW.step == 5.0
    assert PREVIEW.index(-9.0) == 0
    assert PREVIEW.index(1002.4) == 200
    assert PREVIEW.index(1002.6) == 201
    assert PREVIEW.index(9e9) == len(PREVIEW.station) - 1
    middles = [float(ROUTE.lane_offset(lane, 0.0)) for lane in (0, 1)]
    assert PREVIEW.nearest_lane(100.0, middles[0] + 0.4 * (middles[1] - middles[0])) == 0
    assert PREVIEW.nearest_lane(100.0, middles[0] + 0.6 * (middles[1] - middles[0])) == 1
    assert PREVIEW.lane_exists(1, 100.0)
    assert not PREVIEW.lane_exists(2, 100.0)
    assert not PREVIEW.lane_exists(-1, 100.0)


def test_a_path_reaches_behind_and_ahead_and_ends_with_the_road():
    path = PREVIEW.follow(1, 1000.0, 203.0, 96.0)
    assert (path.station[0], path.station[-1]) == (905.0, 1205.0)
    assert path.end == math.inf
    assert path.half_width == pytest.approx(0.5 * float(ROUTE.lane_width(1, 0.0)))
    assert path.speed_limit == pytest.approx(25.0)
    near = PREVIEW.follow(0, 2900.0, 400.0)
    assert near.end == near.station[-1] == 3000.0
    assert PREVIEW.follow(0, 3.0, 50.0).station[0] == 0.0


def test_the_felt_acceleration_is_that_of_bend_and_cross_slope():
    curved = RoadPreview(ROUTE)
    curved.curvature = np.full_like(curved.station, 0.002)
    curved.superelevation = np.full_like(curved.station, -0.03)
    felt = curved.felt(np.array([50.0]), 20.0)
    assert felt[0] == pytest.approx(0.8 - 9.81 * math.tan(0.03), rel=1e-3)


class Heading:
    """A road of which only the heading counts."""

    def __init__(self, turns):
        self.ends = np.cumsum([0.0, *turns])

    def evaluate(self, stations, offset):
        return type("Point", (), {"heading": self.ends})


def test_a_seam_is_spread_over_25_m_and_a_bend_is_not():
    station = 5.0 * np.arange(15)
    turns = np.zeros(15)
    turns[7] = 0.015
    found = road_curvature(Heading(turns), station)
    assert found[5:10] == pytest.approx(np.full(5, 0.003 / 5.0))
    assert not found[:5].any()
    assert not found[10:].any()
    turns[7] = 0.025
    assert road_curvature(Heading(turns), station)[7] == pytest.approx(0.025 / 5.0)
    turns[6:9] = 0.015
    assert road_curvature(Heading(turns), station) == pytest.approx(turns / 5.0)


def test_the_tractor_drives_on_the_outside_by_half_of_the_off_tracking():
    curved = RoadPreview(ROUTE)
    curved.curvature = np.full_like(curved.station, 1.0 / 60.0)
    curved.half_width = np.full_like(curved.half_width, 9.0)
    shift = lane_shift(curved, PARAMETERS, 55_000.0, CONFIG.speed.curve_acceleration)
    assert -1.0 < shift[0, 300] < -0.1
    assert shift[0] == pytest.approx(np.full(len(curved.station), shift[0, 300]))
    curved.half_width = np.full_like(
        curved.half_width, 0.5 * PARAMETERS.units[1].width + 0.15 + 0.01
    )
    assert lane_shift(curved, PARAMETERS, 55_000.0, 1.3)[0, 300] == pytest.approx(-0.01)
    curved.half_width -= 0.05
    assert not lane_shift(curved, PARAMETERS, 55_000.0, 1.3).any()


# --- rollover -------------------------------------------------------------------------------


def test_the_threshold_is_below_that_of_a_rigid_truck_and_falls_with_the_load():
    most = PARAMETERS.payload_max
    laden, half, empty = (roll_threshold(PARAMETERS, share * most) for share in (1.0, 0.5, 0.0))
    assert laden < half < empty
    # 0.39 g laden: docs of the lane change's settings.
    assert laden == pytest.approx(0.39 * 9.81, rel=0.02)
    narrow = dataclasses.replace(
        PARAMETERS,
        tire_common=dataclasses.replace(PARAMETERS.tire_common, relaxation_lateral=1e-9),
    )
    assert laden < roll_threshold(narrow, most) < 1.1 * laden


def test_a_slow_sine_is_not_amplified_and_a_quick_one_is():
    model = LateralModel.of(PARAMETERS, 55_000.0, 0.1)
    assert rearward_amplification(model, 15.0, 1e-4) == pytest.approx(1.0, abs=1e-3)
    assert rearward_amplification(model, 25.0, 0.4) > 1.1
    margin = MARGINS.at(55_000.0)
    assert margin.amplification.min() >= 1.0
    assert margin.amplified(1.0) == margin.amplification[0]
    assert margin.amplified(99.0) == margin.amplification[-1]
    assert margin.amplified(22.5) == pytest.approx(margin.amplification[4:6].mean())


def test_margins_are_kept_by_half_tonnes_within_the_allowed_payload():
    assert MARGINS.at(40_000.0) is MARGINS.at(40_240.0)
    assert MARGINS.at(40_000.0) is not MARGINS.at(40_260.0)
    empty = PARAMETERS.gross_mass(0.0)
    assert MARGINS.at(empty - 3000.0).threshold == roll_threshold(PARAMETERS, 0.0)
    heavy = MARGINS.at(empty + PARAMETERS.payload_max + 4000.0)
    assert heavy.threshold == roll_threshold(PARAMETERS, PARAMETERS.payload_max)


# --- caps and references --------------------------------------------------------------------


def test_a_reference_has_constant_acceleration_between_its_nodes():
    profile = SpeedProfile(np.array([0.0, 100.0]), np.array([20.0, 10.0]))
    station = np.array([0.0, 50.0, 100.0])
    found = _reference(station, profile, ego(0.0, 15.0)).speed
    assert found == pytest.approx([20.0, math.sqrt(250.0), 10.0])


@pytest.mark.parametrize(("speed", "launches"), [(7.9, True), (8.0, False)])
def test_a_slow_reference_does_not_hold_back_a_launch(speed, launches):
    station = np.arange(0.0, 400.0, 5.0)
    profile = SpeedProfile(np.array([0.0, 150.0, 151.0, 400.0]), np.array([1.0, 1.0, 12.0, 12.0]))
    found = _reference(station, profile, ego(50.0, speed)).speed
    at = dict(zip(station.tolist(), found.tolist(), strict=True))
    if not launches:
        assert at[60.0] == pytest.approx(1.0)
        return
    assert at[60.0] == pytest.approx(math.sqrt(speed**2 + 2.0 * LAUNCH_ACCELERATION * 10.0))
    # At the truck one step counts; no more than the reference within 200 m.
    assert at[50.0] == pytest.approx(math.sqrt(speed**2 + 2.0 * LAUNCH_ACCELERATION * 5.0))
    assert at[145.0] == pytest.approx(12.0)
    far = _reference(station, profile, ego(-60.0, speed)).speed
    assert far[20] == pytest.approx(1.0)


def test_a_launch_never_lowers_a_fast_reference():
    station = np.arange(0.0, 400.0, 5.0)
    fast = profile((0, 15), (400, 15))
    assert _reference(station, fast, ego(50.0, 5.0)).speed == pytest.approx(15.0)


def test_behind_a_leader_that_brakes_a_little_the_closing_speed_may_count_more():
    config = CONFIG.speed
    lead = Lead(22.0, 10.0, -1.1)
    way, slower = lead.at(config.reaction_time)
    room = 22.0 + way - 20.0 * config.reaction_time - config.emergency_margin
    closing = (20.0 - slower) ** 2 / (2.0 * room)
    stopping = 20.0**2 / (2.0 * (room + slower**2 / 2.2))
    assert closing > stopping
    assert most_urgent([lead], 20.0, config) == pytest.approx(closing)


def caps(preview=PREVIEW):
    return SpeedCaps(preview, Planner(ROUTE, CONFIG, PARAMETERS).config)


def test_the_top_speed_of_a_change_is_that_of_power_and_reference():
    found = caps()
    truck = ego(speed=10.0)
    longest = CONFIG.change.duration_max
    pull = min(
        power_acceleration(10.0, truck.mass, 0.0, found.config.speed),
        CONFIG.speed.following.acceleration_max,
    )
    assert 10.0 + pull * longest > CONFIG.speed.cruise_speed
    assert found.top(truck, None) == CONFIG.speed.cruise_speed
    heavy = dataclasses.replace(truck, mass=300_000.0)
    pull = power_acceleration(10.0, heavy.mass, 0.0, found.config.speed)
    assert found.top(heavy, None) == pytest.approx(10.0 + pull * longest)
    assert found.top(ego(speed=20.0), None) == 20.0
    # The reference ahead counts as far as the truck drives during the change.
    for rise, top in ((1092.0, 10.0), (1082.0, 14.0)):
        rises = profile((0, 10), (rise, 10), (rise + 3.0, 14), (3000, 14))
        assert found.top(ego(speed=10.0), rises) == pytest.approx(top)
    assert found.power_left(heavy) == pytest.approx(pull)


@pytest.mark.parametrize("given", ["profile", "cruise speed"])
def test_a_set_speed_that_falls_at_once_is_approached_gently_and_not_undershot(given):
    slow = PlannerConfig(speed=SpeedConfig(cruise_speed=13.0 if given != "profile" else 25.0))
    planner, now, speeds, rates = Planner(ROUTE, slow), ego(300.0, speed=18.0), [], []
    wanted = profile((0, 13), (3000, 13)) if given == "profile" else None
    for _ in range(200):
        plan = planner.plan(Scene(now.time, now), profile=wanted)
        now = advanced(now, plan)
        speeds.append(now.speed)
        rates.append(now.acceleration)
    easy = CONFIG.speed.following.preview_deceleration
    assert min(rates) > -1.3 * easy
    assert min(speeds) > 12.9
    assert speeds[130] == pytest.approx(13.0, abs=0.1)


def test_a_limit_that_falls_at_once_is_not_approached_gently():
    planner = Planner(ROUTE, CONFIG)
    zone = SpeedZone(0.0, 3_000.0, 10.0)
    scene = Scene(0.0, ego(300.0, speed=15.0), signals=RoadSignals(zones=(zone,)))
    assert planner.plan(scene).acceleration.min() < -2.0


def test_the_cap_refuses_a_reference_that_is_not_a_number():
    profile = SpeedProfile(np.array([0.0, 3000.0]), np.array([10.0, math.nan]))
    with pytest.raises(InputError, match="not a number"):
        caps().cap(path_of(), profile, MARGINS.at(30_000.0), ego())


def test_a_bend_bounds_the_speed_by_the_rollover_threshold():
    sharp = RoadPreview(ROUTE)
    sharp.curvature = np.where(sharp.station > 1500.0, 1.0 / 100.0, 0.0)
    margin = MARGINS.at(30_000.0)
    found = caps(sharp)
    bound = math.sqrt(CONFIG.curve_share * margin.threshold * 100.0)
    assert found.bearable(1600.0, margin) == pytest.approx(bound)
    # The last row of the straight is within a step of the bend.
    row = sharp.station[sharp.index(1500.0)]
    assert found.bearable(row, margin) == pytest.approx(bound)
    braking = CONFIG.speed.following.preview_deceleration
    before = found.bearable(1400.0, margin)
    # The speed is reached by the row at which the bend begins.
    least, most = (math.sqrt(bound**2 + 2.0 * braking * way) for way in (99.0, 106.0))
    assert least <= before <= most
    assert found.bearable(1600.0, MARGINS.at(55_000.0)) < bound


def profile(*rows):
    return SpeedProfile(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(0, 10)], "two rows"),
        ([(0, 10), (math.nan, 10)], "not finite"),
        ([(0, 10), (5, math.inf)], "not finite"),
        ([(0, 10), (7, 10), (7, 10), (3, 10)], "do not after 7 m"),
        ([(0, 10), (9, 0.49)], "0.49 m/s at station 9 m"),
        ([(0, 10), (9, 60.1), (10, 70)], "60.1 m/s at station 9 m"),
    ],
)
def test_an_impossible_profile_is_refused_by_name(rows, message):
    with pytest.raises(InputError, match=message):
        check_profile(profile(*rows), "test")
    check_profile(profile((0, 0.5), (1, 60.0)), "test")


def test_a_profile_must_cover_the_road_ahead():
    covers = profile((100, 10), (200, 10))
    check_covers(covers, 0.0, 101.0, "test")
    check_covers(covers, 199.9, 300.0, "test")
    for station, length in ((200.0, 300.0), (0.0, 100.0), (math.nan, 300.0)):
        with pytest.raises(InputError, match="100 to 200 m"):
            check_covers(covers, station, length, "test")
    cruise = CruiseReference(12.0, "why")
    assert (cruise.at(55.0), cruise.free(9.0), cruise.reason) == (12.0, 12.0, "why")


# --- stops ----------------------------------------------------------------------------------


def stops(config=CONFIG):
    return Stops(PREVIEW, config, PARAMETERS)


def test_the_nearest_stop_counts_and_the_others_bound_the_speed():
    found, path = stops(), path_of()
    truck = Scene(0.0, ego(), ())
    cap = np.full(len(path.station), 20.0)
    assert found.nearest(truck, path, cap, False)[0] == math.inf
    overhang = truck.footprint.front_overhang
    found.light = LightDemand(stop=1200.0, deceleration=1.1)
    found._bend = 1150.0
    stop, braking, bound = found.nearest(truck, path, cap, False)
    assert (stop, braking) == (1150.0, DECELERATION)
    at = dict(zip(path.station.tolist(), bound.tolist(), strict=True))
    assert at[1190.0] == pytest.approx(math.sqrt(2.2 * (10.0 - overhang)))
    assert at[1000.0] == 20.0
    assert at[1250.0] == 0.0


def test_a_lane_that_ends_is_stopped_in_with_the_room_for_a_change():
    found = stops()
    end = 1300.0
    path = dataclasses.replace(path_of(), end=end)
    truck = Scene(0.0, ego(), ())
    overhang, merge = truck.footprint.front_overhang, CONFIG.merge
    cap = np.full(len(path.station), 20.0)
    stop, braking, _ = found.nearest(truck, path, cap, False)
    assert stop == end - CONFIG.speed.stop_gap - overhang
    assert braking == CONFIG.speed.following.preview_deceleration
    stop, braking, _ = found.nearest(truck, path, cap, True)
    assert (stop, braking) == (end - merge.room - overhang, merge.stop_deceleration)


def test_a_known_change_to_green_is_approached_at_its_speed_up_to_the_line():
    found, path = stops(), path_of()
    found.light = LightDemand(stop=1200.0, deceleration=2.0, speed=6.0)
    truck = Scene(0.0, ego(speed=12.0), ())
    cap = np.full(len(path.station), 20.0)
    _, _, bound = found.nearest(truck, path, cap, False)
    at = dict(zip(path.station.tolist(), bound.tolist(), strict=True))
    b = CONFIG.light.arrival_deceleration
    assert at[990.0] == at[1000.0] == 12.0
    assert at[1030.0] == pytest.approx(math.sqrt(144.0 - 60.0 * b))
    assert at[1150.0] == pytest.approx(6.0)
    assert at[1200.0] == 20.0


@pytest.mark.parametrize(
    ("left", "speed", "holds"),
    [
        (0.9, 0.29, True),
        (0.9, 0.31, False),
        (1.1, 0.1, False),
        (-0.5, 0.59, True),
        (-0.5, 0.61, False),
    ],
)
def test_a_truck_at_rest_near_its_stop_stays(left, speed, holds):
    found = stops()
    assert found.holds(1000.0 + left, ego(speed=speed)) is holds


def test_a_held_truck_stays_until_its_stop_moves_on():
    found = stops()
    assert found.holds(1000.5, ego(speed=0.0))
    assert found.holds(1000.6, ego(speed=2.0))
    assert found.holds(1001.4, ego(speed=2.0))
    assert not found.holds(1001.6, ego(speed=2.0))
    found.holds(1000.5, ego(speed=0.0))
    found.reset()
    assert not found.holds(1000.5, ego(speed=2.0))


def stopped_car(gap=60.0, **fields):
    front = Scene(0.0, ego(), ()).neighbors.front
    return car(ROUTE, "stopped", front + gap + 2.25, 0, 0.0, **fields)


def test_the_truck_leaves_room_behind_a_vehicle_that_it_will_pass():
    found, path = stops(), path_of()
    scene = Scene(0.0, ego(speed=5.0), (stopped_car(),))
    leader = scene.neighbors.leader_along_path(path)
    front = scene.neighbors.front
    expected = front + leader.gap - CONFIG.passing.gap
    assert found._keeps_room(scene, path, None) == pytest.approx(expected)
    fast = Scene(0.0, ego(speed=15.0), (stopped_car(),))
    assert found._keeps_room(fast, path, None) == math.inf
    only = stops(dataclasses.replace(CONFIG, lanes=(0,)))
    assert only._keeps_room(scene, path, None) == math.inf
    assert found._keeps_room(scene, path, Change(0.0, 3.5)) == math.inf
    aborted = Change(0.0, 3.5, "stopped", True)
    assert found._keeps_room(scene, path, aborted) == pytest.approx(expected)
    assert found._keeps_room(scene, path, dataclasses.replace(aborted, aborted=False)) == math.inf


def test_a_vehicle_that_stands_before_a_light_is_no_breakdown():
    path, config = path_of(), CONFIG.passing
    truck = stopped_car()
    assert stopped_leader(Scene(0.0, ego(), (truck,)), path, config, 400.0).id == "stopped"
    gap = Scene(0.0, ego(), (truck,)).neighbors.leader_along_path(path).gap
    assert stopped_leader(Scene(0.0, ego(), (truck,)), path, config, gap - 0.1) is None
    for speed, stands in ((0.5, True), (0.51, False), (-0.6, False)):
        rolling = dataclasses.replace(truck, speed=speed)
        found = stopped_leader(Scene(0.0, ego(), (rolling,)), path, config, 400.0)
        assert (found is not None) is stands
    for ahead, waits in ((-5.1, False), (-4.9, True), (149.0, True), (151.0, False)):
        light = TrafficLight(station=truck.station + ahead, state=LightState.RED)
        scene = Scene(0.0, ego(), (truck,), signals=RoadSignals(light=light))
        assert (stopped_leader(scene, path, config, 400.0) is None) is waits


def test_the_truck_passes_a_vehicle_that_stands_alone_for_some_seconds():
    leader = StoppedLeader(PREVIEW, CONFIG)
    path, truck = path_of(), stopped_car(15.0)

    def passes(time, *vehicles, speed=0.0):
        return leader.passes(Scene(time, ego(speed=speed), vehicles), path)

    patience = CONFIG.passing.patience
    assert passes(10.0, truck) == (False, "")
    assert passes(10.0 + patience - 0.01, truck) == (False, "")
    assert passes(10.0 + patience, truck) == (True, "")
    # Another vehicle, a moving truck or a queue begins the wait again.
    other = dataclasses.replace(truck, id="other")
    assert passes(20.0, other) == (False, "")
    assert passes(20.0 + patience, other) == (True, "")
    assert passes(30.0, other, speed=0.51) == (False, "")
    assert passes(30.1, other) == (False, "")
    queue = car(ROUTE, "queue", truck.station + 20.0, 0, 0.0)
    assert passes(40.0, truck, queue) == (False, "staying in the queue behind stopped")
    beside = car(ROUTE, "beside", truck.station + 10.0, 1, 1.9)
    assert passes(41.0, truck, beside)[1] != ""
    moving = dataclasses.replace(beside, speed=2.1)
    assert passes(42.0, truck, moving) == (False, "")
    far = car(ROUTE, "far", truck.station + truck.length + CONFIG.passing.free + 1.0, 0, 0.0)
    assert passes(42.0 + patience, truck, far) == (True, "")


# --- bends ----------------------------------------------------------------------------------


def test_a_tight_bend_is_found_within_sight_until_the_trailer_is_through():
    preview = RoadPreview(bend())
    bends = TightBends(preview, PARAMETERS)
    assert len(bends._bends) == 1
    begin, over = bends._bends[0]
    assert np.abs(preview.curvature[(preview.station < begin - 5.0)]).max() <= 1.0 / 35.0
    path = preview.follow(0, begin - 50.0, 400.0, 150.0)
    truck = EgoState(station=begin - 79.0, speed=3.0)
    sweep = bends.ahead(path, truck)
    assert begin - 16.0 <= sweep.first < sweep.last <= over + 45.0
    assert sweep.begin <= min(begin, sweep.first) - 1.5 + 1e-9
    assert len(sweep.units[0].x) == round(sweep.last - sweep.first) + 1
    assert bends.ahead(path, dataclasses.replace(truck, station=begin - 81.0)) is None
    assert bends.ahead(path, dataclasses.replace(truck, station=sweep.last + 0.1)) is None
    assert bends.ahead(path, dataclasses.replace(truck, station=sweep.last - 0.1)) is sweep
    straight = TightBends(PREVIEW, PARAMETERS)
    assert straight._bends == []


def test_a_vehicle_is_expected_to_yield_the_more_the_longer_the_truck_waits():
    preview = RoadPreview(bend())
    bends = TightBends(preview, PARAMETERS)
    neighbors = Scene(0.0, EgoState(station=200.0), (oncoming("car", 300.0, 10.0),)).neighbors
    one = Poses.of(neighbors, np.array([True]), preview)
    times = np.linspace(0.0, 15.0, 31)
    touched = times > 7.9
    # 80 m less the reaction's 7.5 m: 100 / 145 = 0.69 m/s2 are needed.
    assert not bends._yields(one, times, touched)
    for waited, yields in ((2.2, False), (2.4, True), (60.0, True)):
        bends._waited = waited
        assert bends._yields(one, times, touched) is yields
    near = times > 5.9
    assert not bends._yields(one, times, near)
    bends._set_out = True
    assert bends._yields(one, times, near)
    assert not bends._yields(one, times, times >= 0.0)


# --- poses ----------------------------------------------------------------------------------


def pose(**fields):
    vehicle = car(ROUTE, "car", 1050.0, 1, 10.0, **fields)
    scene = Scene(0.0, ego(), (vehicle,))
    return Poses.of(scene.neighbors, np.array([True]), PREVIEW)


def test_a_vehicle_without_a_pose_moves_along_its_speeds_on_the_road():
    plain = pose()
    point = ROUTE.evaluate(1050.0, float(ROUTE.lane_offset(1, 1050.0)))
    assert (plain.x[0], plain.y[0]) == pytest.approx((float(point.x), float(point.y)))
    assert (plain.speed[0], plain.to_road[0], plain.braking[0]) == (10.0, 0.0, 0.0)
    assert pose(acceleration=-2.0).braking[0] == 2.0
    assert pose(acceleration=2.0).braking[0] == 0.0


def test_a_reversing_vehicle_is_predicted_against_its_heading():
    vehicle = car(ROUTE, "car", 1050.0, 1, -4.0, acceleration=1.5)
    scene = Scene(0.0, ego(), (vehicle,))
    back = Poses.of(scene.neighbors, np.array([True]), PREVIEW)
    assert abs(back.to_road[0]) == pytest.approx(math.pi)
    assert (back.speed[0], back.braking[0]) == (4.0, 1.5)


# --- the planner ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shared():
    return Planner(ROUTE, CONFIG, PARAMETERS)


@pytest.fixture
def planner(shared):
    shared.reset()
    return shared


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"mass": 1.0}, "mass is 1 kg"),
        ({"mass": 200_000.0}, "mass is 200000 kg"),
        ({"station": -40.0}, "station is -40 m: the road has 0 to 3000 m"),
        ({"station": 3040.0}, "station is 3040 m"),
        ({"speed": math.nan}, "speed is nan"),
    ],
)
def test_a_state_without_a_plan_is_refused_by_name(planner, fields, message):
    with pytest.raises(InputError, match=message):
        planner.plan(Scene(0.0, dataclasses.replace(ego(), **fields), ()))


def test_decisions_are_named_by_themselves_or_their_numbers():
    for decision in Decision:
        assert named_decision(decision) is decision
        assert named_decision(int(decision)) is decision
    for wrong in (7, "left", 0.5, None):
        with pytest.raises(InputError, match="decision is"):
            named_decision(wrong)


def test_the_plan_starts_at_the_last_plans_speed_near_the_trucks(planner):
    first = planner._start(Scene(0.0, ego(), ()), math.inf)
    assert first == SpeedState(1000.0, 15.0, 0.0)
    plan = planner.plan(Scene(0.0, ego(), ()))
    now, reach = float(plan.time[3]), CONFIG.resync_speed
    planned, pull = float(plan.speed[3]), float(plan.acceleration[3])
    for off, expected in ((0.0, 0.0), (0.9, 0.9 - reach), (-0.9, reach - 0.9), (0.3, 0.0)):
        found = planner._start(Scene(now, ego(speed=planned + off), ()), math.inf)
        assert found.speed == pytest.approx(planned + expected)
        assert found.acceleration == pytest.approx(pull)
    # Near a stop, a slow truck that is too fast is not followed by the plan as far down.
    planner._last = dataclasses.replace(
        plan, speed=np.full_like(plan.speed, 5.0), acceleration=np.full_like(plan.speed, -9.0)
    )
    for speed, stop, expected in (
        (5.4, 1029.0, 5.3),
        (5.4, 1031.0, 5.0),
        (5.8, 1031.0, 5.3),
        (4.6, 1029.0, 5.0),
    ):
        found = planner._start(Scene(now, ego(speed=speed), ()), stop)
        assert found.speed == pytest.approx(expected)
        assert found.acceleration == -CONFIG.speed.following.deceleration_max
    planner._emergency = True
    assert planner._start(Scene(now, ego(speed=5.0), ()), math.inf).acceleration == -9.0
    stand = dataclasses.replace(planner._last, speed=np.zeros_like(plan.speed))
    planner._last = stand
    assert planner._start(Scene(now, ego(speed=0.0), ()), math.inf).acceleration == 0.0
    late = planner._start(Scene(99.0, ego(speed=7.0), ()), math.inf)
    assert (late.speed, late.acceleration) == (7.0, 0.0)


@pytest.mark.parametrize("gap", [25.0, 22.0, 17.0, 6.0])
def test_an_emergency_demands_more_than_required_within_its_bounds(planner, gap):
    speed, settings = 15.0, CONFIG.speed
    vehicle = car(ROUTE, "ahead", 1000.0 + gap + 2.25 + 1.4, 0, 4.0)
    scene = Scene(0.0, ego(speed=speed), (vehicle,))
    plan = planner.plan(scene)
    lead = scene.neighbors.leader_along_path(path_of())
    urgency = most_urgent([Lead.of(lead)], speed, settings)
    assert plan.extra["urgency"] == pytest.approx(urgency)
    emergency = urgency > settings.emergency_onset
    assert (plan.mode is PlanMode.EMERGENCY) is emergency
    assert planner.emergencies == int(emergency)
    if emergency:
        demand = max(settings.emergency_share * urgency, settings.emergency_onset)
        demand = min(demand, settings.emergency_deceleration)
        assert plan.acceleration[0] == pytest.approx(-demand)
        assert plan.reason == "emergency braking: following ahead"
        # It lasts until much less is required, and is counted once.
        planner.plan(dataclasses.replace(scene, time=0.1))
        assert planner.emergencies == 1


def test_the_leader_of_the_lane_being_left_counts_until_the_truck_is_beside(planner):
    path = path_of(1)
    residual = Quintic.to_zero(
        1000.0, 90.0, -float(np.diff([ROUTE.lane_offset(0, 0.0), ROUTE.lane_offset(1, 0.0)])[0])
    )

    def leads(gap, speed):
        vehicle = car(ROUTE, "old", 1000.0 + gap + 2.25 + 1.4, 0, speed)
        scene = Scene(0.0, ego(speed=15.0), (vehicle,))
        old = scene.neighbors.leader_along_path(path_of(0))
        return planner._old_leader(scene, path, residual, old), scene, old

    found, scene, old = leads(20.0, 8.0)
    clear = 0.5 * (old.width + scene.footprint.width) + CONFIG.change.side_gap
    fine = np.linspace(1000.0, 1090.0, 2000)
    offsets = path.driven_at(fine) + residual.evaluate(fine)[0]
    free_at = fine[np.argmax(np.abs(offsets - old.offset) > clear)]
    assert [lead.until for lead in found] == [pytest.approx((free_at - 1000.0) / 15.0, abs=0.2)]
    assert (found[0].gap, found[0].speed) == (old.gap, 8.0)
    until = found[0].until
    needed = 7.0 * until + CONFIG.safety.margin
    assert leads(needed - 0.5, 8.0)[0]
    assert not leads(needed + 0.5, 8.0)[0]
    # A faster leader only needs the margin.
    assert not leads(CONFIG.safety.margin + 0.5, 20.0)[0]
    assert leads(CONFIG.safety.margin - 0.5, 20.0)[0]


def test_the_modes_of_a_change_are_named(planner):
    maneuver = planner.maneuver
    assert (maneuver.mode, maneuver.passing_until) == (PlanMode.LANE_KEEPING, -math.inf)
    maneuver.residual = Quintic.to_zero(1000.0, 60.0, 3.0)
    maneuver.change = Change(0.0, 3.0)
    assert (maneuver.mode, maneuver.passing_until) == (PlanMode.LANE_CHANGE, -math.inf)
    maneuver.change = Change(0.0, 3.0, "stopped")
    assert maneuver.passing_until == 1060.0
    maneuver.change.aborted = True
    assert (maneuver.mode, maneuver.passing_until) == (PlanMode.ABORT, -math.inf)


def test_a_truck_far_from_its_plan_is_led_back_from_where_it_is(planner):
    middle = float(ROUTE.lane_offset(0, 1000.0))
    for aside, led in ((0.79, False), (0.81, True), (-0.81, True)):
        planner.reset()
        truck = dataclasses.replace(ego(), offset=middle + aside)
        plan = planner.plan(Scene(0.0, truck, ()))
        assert (planner.maneuver.residual is not None) is led
        assert plan.offset[0] == pytest.approx(middle + (aside if led else 0.0))
    end = planner.maneuver.residual.end
    planner.plan(Scene(1.0, ego(end - 1.0), ()))
    assert planner.maneuver.residual is not None
    planner.plan(Scene(2.0, ego(end + 1.0), ()))
    assert planner.maneuver.residual is None
    assert planner.lane_changes == 0


def test_a_completed_change_is_counted_when_the_truck_has_settled(planner):
    truck = ego(lane=1, station=1080.0)
    maneuver = planner.maneuver
    maneuver.lane(truck)
    maneuver._middle = truck.offset
    maneuver.residual = Quintic.to_zero(1000.0, 80.0, -3.0)
    maneuver.change = Change(float(ROUTE.lane_offset(0, 0.0)), 3.5)
    unsettled = dataclasses.replace(truck, offset=truck.offset + 0.41)
    planner.plan(Scene(5.0, unsettled, ()))
    assert planner.changing
    planner.plan(Scene(5.1, dataclasses.replace(truck, offset=truck.offset + 0.39), ()))
    assert not planner.changing
    assert (planner.lane_changes, planner.aborted) == (1, 0)
    assert maneuver._changed_at == 5.1
