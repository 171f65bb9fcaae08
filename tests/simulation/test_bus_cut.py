"""The bus fails while the stack drives over it, and returns."""

import numpy as np
import pytest

from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.safe_stop.fallback import CommandSource, Fallback
from controllers.safe_stop.stop import SafeStop, StopPhase
from controllers.stack import Stack
from iits_mj.core.messages import Scene
from iits_mj.j1939 import CommandReceiver, command_to_frames
from iits_mj.road import RoadMap
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.truck import Truck

STATION, SPEED = 10_960.0, 80.0 / 3.6
TIME, OFFSET, REAL_SPEED = range(3)


class Chain(Observer):
    """Stack, frames, receiver, fallback and truck, 20 ms at a time, in a bend of 620 m."""

    def __init__(self, payload, stops=True):
        self.route = RoadMap.builtin().route()
        self.truck = Truck.load(payload=payload, route=self.route, visuals=False)
        self.truck.reset(
            station=STATION, offset=float(self.route.lane_offset(0, STATION)), speed=SPEED
        )
        config = PlannerConfig(speed=SpeedConfig(cruise_speed=SPEED))
        self.stack = Stack(self.route, planner=config, parameters=self.truck.parameters)
        self.plan = self.stack.plan
        self.receiver = CommandReceiver()
        self.fallback = Fallback(SafeStop(self.route, self.truck.parameters)) if stops else None
        self.lock_step = LockStep(self.truck, self, lambda ego: Scene(ego.time, ego), [self])
        self.cycle, self.cut, self.rows = 0, False, []

    def control(self, ego):
        """Returns the command of the stack's frames, or of the fallback without frames."""
        command = self.stack.control(ego)
        if not self.cut:
            for frame in command_to_frames(command, self.cycle, ego.time):
                self.receiver.receive(frame)
        self.cycle += 1
        obeyed = self.receiver.command(ego.time)
        if self.fallback is None:
            return obeyed
        return self.fallback.command(ego, obeyed, self.receiver.loss(ego.time).driver)

    def commanded(self, ego, wanted, obeyed):
        middle = float(self.route.lane_offset(0, ego.station))
        self.rows.append((ego.time, ego.offset - middle, ego.speed))

    def drive(self, duration, cut=False):
        """Returns rows of time, distance to the lane's middle, speed."""
        self.cut, self.rows = cut, []
        self.lock_step.advance(duration)
        return np.array(self.rows)


@pytest.mark.parametrize(
    "payload", [pytest.param(36_000.0, marks=pytest.mark.slow), 0.0], ids=["laden", "empty"]
)
def test_a_cut_bus_stops_the_truck_in_its_lane(payload):
    chain = Chain(payload)
    chain.drive(2.0)
    rows = chain.drive(19.0, cut=True)
    assert chain.fallback.stop.phase is StopPhase.PARKED
    assert abs(rows[-1, REAL_SPEED]) < 0.01
    assert np.abs(rows[:, OFFSET]).max() < 0.3
    assert chain.truck.last_command().parking_brake == 1.0


def test_a_bus_that_returns_drives_the_truck_again():
    chain = Chain(0.0)
    chain.drive(2.0)
    slowed = chain.drive(3.0, cut=True)
    assert slowed[-1, REAL_SPEED] < SPEED - 1.5
    rows = chain.drive(8.0)
    assert chain.fallback.source is CommandSource.COMMANDS
    assert rows[-1, REAL_SPEED] > rows[:, REAL_SPEED].min() + 1.0
    assert np.abs(rows[:, OFFSET]).max() < 0.4
    # The counters continued during the cut: no frame after it is rejected.
    assert not chain.receiver.rejected


@pytest.mark.slow
def test_a_parked_truck_sets_off_again_when_the_bus_returns():
    chain = Chain(0.0)
    chain.drive(1.0)
    parked = chain.drive(20.0, cut=True)
    assert abs(parked[-1, REAL_SPEED]) < 0.01
    rows = chain.drive(12.0)
    assert rows[-1, REAL_SPEED] > 2.0
    assert rows[:, REAL_SPEED].min() > -0.15


def test_a_gap_shorter_than_the_time_outs_does_not_stop_the_truck():
    chain = Chain(0.0)
    chain.drive(1.0)
    chain.drive(0.08, cut=True)
    rows = chain.drive(1.0)
    assert chain.fallback.stops == 0
    assert rows[:, REAL_SPEED].min() > SPEED - 0.5


def test_without_a_fallback_the_truck_coasts_with_the_wheel_held():
    chain = Chain(0.0, stops=False)
    chain.drive(2.0)
    angle = chain.truck.last_command().steering_wheel_angle
    rows = chain.drive(3.0, cut=True)
    command = chain.truck.last_command()
    assert command.steering_wheel_angle == angle
    assert (command.accelerator_pedal, command.xbr_demand) == (0.0, 0.0)
    assert rows[-1, REAL_SPEED] > SPEED - 1.5
