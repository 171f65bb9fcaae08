"""Emergency braking: what is in the way, what it needs, and when it warns and brakes."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.emergency_braking import (
    EmergencyBraking,
    EmergencyState,
)
from controllers.emergency_braking.threat import (
    Target,
    along_arc,
    find_targets,
    required_deceleration,
)
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoFootprint,
    EgoState,
    Scene,
    TrackedVehicle,
    VehicleCommand,
    XbrMode,
)
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import TruckParameters

TRUCK = TruckParameters.load()
FOOTPRINT = EgoFootprint()
SPEED = 80.0 / 3.6


def car(ahead, left=0.0, speed=0.0, **more):
    """A car whose rear is `ahead` of the front bumper of a truck at the origin."""
    return TrackedVehicle("car", x=1.4 + ahead + 2.4, y=left, speed=speed, **more)


def targets(*vehicles, curvature=0.0, **ego):
    state = EgoState(**{"speed": SPEED, **ego})
    frame = VehicleFrame.of(vehicles)
    return find_targets(state, frame, 0.0, FOOTPRINT, curvature)


class Approach:
    """Drives a truck towards a car: it obeys the emergency braking, whose stages it logs."""

    def __init__(self, gap, speed=SPEED, car_speed=0.0, human=False, friction=0.8, **parts):
        self.guard = EmergencyBraking(TRUCK, lambda _: friction, human=human)
        self.gap, self.speed, self.car_speed, self.time = gap, speed, car_speed, 0.0
        self.deceleration, self.log = 0.0, []
        self.mu, self.parts = friction, parts

    def run(self, duration, command=lambda time: VehicleCommand()):
        for k in range(round(duration / 0.02)):
            ego = EgoState(time=self.time, x=0.0, speed=self.speed, acceleration=-self.deceleration)
            if k % 5 == 0:
                vehicles = [car(self.gap, speed=self.car_speed, **self.parts)]
                self.guard.observe(Scene(self.time, ego, vehicles, FOOTPRINT))
            demand = self.guard.demand(ego, command(self.time))
            self.log.append((self.time, self.guard.report.state, demand, self.gap, self.speed))
            # Brakes with the lag of a truck's.
            wanted = min(-demand, 0.94 * self.mu * 9.81)
            self.deceleration += 0.02 / 0.25 * (wanted - self.deceleration)
            # Between two scenes the guard moves the car by itself, the truck stays at x = 0.
            self.gap += 0.02 * (self.car_speed - self.speed)
            self.speed = max(self.speed - 0.02 * self.deceleration, 0.0)
            self.time += 0.02
            if self.gap <= 0.0 or self.speed <= 0.0:
                break
        return self

    def first(self, *states):
        return next((row[0] for row in self.log if row[1] in states), math.nan)


def test_a_steady_target_needs_the_energy_of_the_closing_speed():
    assert required_deceleration(Target("", 51.0, 10.0, 0.0), 20.0, 1.0) == pytest.approx(1.0)


def test_a_target_that_stops_needs_its_stopping_distance_too():
    # 20 m/s, 50 m and 25 m of the target: 400 / 150.
    needed = required_deceleration(Target("", 50.0, 10.0, -2.0), 20.0, 0.0)
    assert needed == pytest.approx(400.0 / 150.0)


@pytest.mark.parametrize("speed", [12.0, 16.0, 22.0])
@pytest.mark.parametrize("braking", [0.0, 2.0, 7.0])
def test_the_required_deceleration_just_avoids_the_target(speed, braking):
    target = Target("", 30.0, 14.0, -braking)
    needed = required_deceleration(target, speed, 0.0)
    time = np.linspace(0.0, 60.0, 60_001)

    def way(start, slowing):
        end = np.minimum(time, start / slowing) if slowing else time
        return start * end - 0.5 * slowing * end**2

    gap = 30.0 + way(14.0, braking) - way(speed, needed)
    if needed:
        assert gap.min() == pytest.approx(0.0, abs=0.01)
    else:
        assert gap.min() > 0.0


def test_the_way_is_as_wide_as_the_truck():
    assert len(targets(car(40.0))) == 1
    assert len(targets(car(40.0, 1.9))) == 1
    assert not targets(car(40.0, 2.3))
    assert not targets(car(40.0, -3.75))


def test_the_way_follows_the_yaw_rate():
    curvature = 1.0 / 200.0
    aside = 200.0 - math.sqrt(200.0**2 - 45.0**2)
    inside = car(45.0 - 3.8, aside, yaw=math.asin(45.0 / 200.0))
    assert targets(inside, curvature=curvature)
    assert not targets(inside)
    assert not targets(car(41.2), curvature=curvature)


def test_an_arc_and_back():
    along, offset = along_arc(np.array([30.0]), np.array([5.0]), -1.0 / 100.0)
    angle = math.atan2(30.0, 105.0)
    assert along[0] == pytest.approx(100.0 * angle)
    assert offset[0] == pytest.approx(math.hypot(30.0, 105.0) - 100.0)


def test_oncoming_vehicles_and_bridges_do_not_count():
    assert not targets(car(40.0, speed=15.0, yaw=math.pi))
    assert not targets(car(40.0, z=6.0))
    assert targets(car(40.0, z=6.0), pitch=-0.15)


def test_a_vehicle_that_cuts_in_counts_before_it_is_there():
    assert not targets(car(20.0, 2.8))
    assert targets(car(20.0, 2.8, lateral_speed=-1.0))
    assert not targets(car(20.0, 1.5, lateral_speed=1.5))


def test_a_pedestrian_counts_who_will_be_in_the_way_on_arrival():
    walker = TrackedVehicle(
        "w", "pedestrian", x=45.0, y=-4.0, yaw=1.57, speed=1.5, lateral_speed=1.5, length=0.5,
        width=0.5,
    )  # fmt: skip
    assert targets(walker)
    assert not targets(dataclasses.replace(walker, speed=0.3, lateral_speed=0.3))
    assert not targets(dataclasses.replace(walker, y=2.0))


def test_it_warns_1_4_s_before_it_brakes_and_brakes_in_time():
    drive = Approach(150.0).run(15.0)
    warned = drive.first(EmergencyState.WARNING)
    braked = drive.first(EmergencyState.BRAKING)
    partial = drive.first(EmergencyState.PARTIAL)
    assert braked - warned >= 1.4
    assert braked - partial >= 0.8 - 1e-6
    assert drive.gap > 0.3
    assert drive.speed <= 0.0
    strong = [row[2] for row in drive.log if row[1] is EmergencyState.BRAKING]
    assert max(strong[:50]) <= -4.0


def test_it_brakes_sooner_on_a_wet_road():
    dry = Approach(150.0).run(15.0)
    wet = Approach(150.0, friction=0.5).run(15.0)
    assert wet.first(EmergencyState.BRAKING) < dry.first(EmergencyState.BRAKING) - 0.5
    assert wet.gap > 0.0


def test_it_waits_for_no_warning_when_the_target_appears_close():
    drive = Approach(25.0).run(0.2)
    assert drive.first(EmergencyState.BRAKING) < 0.03


def test_a_driver_who_brakes_enough_gets_no_warning():
    guard = EmergencyBraking(TRUCK)
    ego = EgoState(speed=SPEED, acceleration=-5.0)
    scene = Scene(0.0, ego, [car(75.0)], FOOTPRINT)
    guard.observe(scene)
    guard.demand(ego, VehicleCommand())
    assert guard.report.state is EmergencyState.STANDBY
    calm = dataclasses.replace(ego, acceleration=0.0)
    guard.demand(calm, VehicleCommand())
    assert guard.report.state is EmergencyState.WARNING


def test_it_never_weakens_the_planner():
    drive = Approach(150.0)
    planner = VehicleCommand(xbr_demand=-6.0, xbr_mode=XbrMode.MAXIMUM)
    drive.run(15.0, lambda _: planner)
    assert all(row[2] in (0.0, -6.0) or row[2] < -6.0 for row in drive.log)


def test_it_is_off_at_walking_speed_but_finishes_what_it_began():
    slow = Approach(3.0, speed=1.0).run(2.0)
    assert {row[1] for row in slow.log} == {EmergencyState.OFF}
    assert Approach(60.0, speed=12.0).run(20.0).gap > 0.0


def test_a_kick_down_overrides_only_if_a_driver_drives():
    def kick(time):
        return VehicleCommand(accelerator_pedal=1.0 if time > 4.5 else 0.3)

    human = Approach(150.0, human=True).run(15.0, kick)
    assert human.first(EmergencyState.OVERRIDDEN) == pytest.approx(4.52, abs=0.03)
    assert human.gap <= 0.0
    stack = Approach(150.0).run(15.0, kick)
    assert math.isnan(stack.first(EmergencyState.OVERRIDDEN))
    assert stack.gap > 0.0


def test_a_fast_turn_of_the_wheel_overrides_too():
    def turn(time):
        return VehicleCommand(steering_wheel_angle=6.0 * max(time - 4.5, 0.0))

    drive = Approach(150.0, human=True).run(15.0, turn)
    assert drive.first(EmergencyState.OVERRIDDEN) < 4.6


def test_weak_brakes_brake_sooner():
    guard = EmergencyBraking(TRUCK)
    light = guard.possible(EgoState(mass=19_000.0))
    heavy = guard.possible(EgoState(mass=300_000.0))
    assert light == pytest.approx(0.92 * 0.8 * 9.81)
    assert heavy < 0.5 * light


def test_a_driver_is_there_or_not():
    with pytest.raises(InputError, match="human"):
        EmergencyBraking(TRUCK, human="yes")
