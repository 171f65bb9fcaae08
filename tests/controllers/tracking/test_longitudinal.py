"""The speed controller's choices call by call: actuators, their order and their rates."""

import dataclasses

import numpy as np
import pytest

from controllers.tracking.longitudinal import LongitudinalConfig, LongitudinalController, Phase
from iits_mj.core.messages import EgoState, Trajectory, XbrEbiMode, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters
from tests.controllers.tracking.reference import Powertrain
from tests.controllers.tracking.speed_reference import coasting_error

PARAMETERS = TruckParameters.load()
LADEN = EgoState(mass=55_000.0, speed=16.67, gear=9, engine_speed=183.0, engine_torque=-150.0)


def plan(speed, acceleration=0.0):
    """A plan that begins with this speed and acceleration, over 5 s."""
    time = np.linspace(0.0, 5.0, 51)
    zero = np.zeros_like(time)
    return Trajectory(
        time=time,
        station=zero,
        offset=zero,
        x=zero,
        y=zero,
        z=zero,
        yaw=zero,
        curvature=zero,
        speed=np.maximum(speed + acceleration * time, 0.0),
        acceleration=np.full_like(time, acceleration),
    )


def run(controller, ego, trajectory, grade, duration):
    """Commands for a truck whose state does not change."""
    return [controller.command(ego, trajectory, grade) for _ in range(round(duration * 50))]


def test_a_gentle_descent_is_held_by_the_engine_brake_alone():
    controller = LongitudinalController(PARAMETERS)
    last = run(controller, LADEN, plan(16.67), -0.03, 3.0)[-1]
    assert controller.phase is Phase.OVERRUN
    assert 0.1 < last.engine_brake < 1.0
    assert (last.retarder, last.accelerator_pedal, last.xbr_mode) == (0.0, 0.0, XbrMode.OFF)


def test_the_retarder_adds_the_force_that_the_engine_brake_lacks():
    controller = LongitudinalController(PARAMETERS)
    last = run(controller, LADEN, plan(16.67), -0.06, 3.0)[-1]
    assert controller.phase is Phase.OVERRUN
    assert last.engine_brake == 1.0
    assert 0.2 < last.retarder < 0.9
    assert last.xbr_mode is XbrMode.OFF


def test_friction_adds_to_engine_brake_and_retarder_at_their_limits():
    controller = LongitudinalController(PARAMETERS)
    last = run(controller, LADEN, plan(16.67), -0.10, 3.0)[-1]
    assert controller.phase is Phase.BRAKE
    assert (last.engine_brake, last.retarder) == (1.0, 1.0)
    assert (last.xbr_mode, last.xbr_ebi_mode) == (XbrMode.MAXIMUM, XbrEbiMode.INTEGRATION)
    assert last.xbr_demand < -0.3


def test_in_a_gear_change_the_retarder_helps_and_the_engine_brakes_request_stays():
    controller = LongitudinalController(PARAMETERS)
    before = run(controller, LADEN, plan(16.67), -0.04, 3.0)[-1]
    changing = dataclasses.replace(LADEN, shift_in_process=True)
    during = run(controller, changing, plan(16.67), -0.04, 0.5)[-1]
    assert during.engine_brake == before.engine_brake > 0.5
    assert during.retarder > before.retarder + 0.3
    assert during.xbr_mode is XbrMode.OFF


def test_hard_braking_is_left_to_brake_control():
    controller = LongitudinalController(PARAMETERS)
    run(controller, LADEN, plan(16.67), -0.06, 3.0)
    last = run(controller, LADEN, plan(16.67, -4.0), -0.06, 1.0)[-1]
    assert (last.engine_brake, last.retarder) == (0.0, 0.0)
    assert last.xbr_ebi_mode is XbrEbiMode.INTEGRATION
    # Plan plus feedback: the truck of this test does not slow down.
    assert last.xbr_demand == pytest.approx(-4.0, abs=0.2)


@pytest.mark.parametrize("wanted", [-1.2, -1.8])
def test_braking_beyond_coasting_is_always_demanded_of_an_actuator(wanted):
    # An empty truck in a low gear: its engine brake would be enough, but does not brake hard.
    empty = EgoState(mass=19_000.0, speed=4.2, gear=4, engine_speed=160.0, engine_torque=-150.0)
    controller = LongitudinalController(PARAMETERS)
    run(controller, empty, plan(4.2, -0.7), 0.0, 1.0)
    assert controller.phase is Phase.OVERRUN
    last = run(controller, empty, plan(4.2, wanted), 0.0, 0.8)[-1]
    assert last.xbr_mode is XbrMode.MAXIMUM
    assert last.xbr_demand < 0.9 * wanted


def test_friction_is_demanded_before_the_engine_brake_fades():
    def asks(speed):
        engine_speed = 110.0 * speed / 5.0
        ego = EgoState(mass=19_000.0, speed=speed, gear=6, engine_speed=engine_speed)
        controller = LongitudinalController(PARAMETERS)
        last = run(controller, ego, plan(speed, -0.85), -0.06, 0.9)[-1]
        return controller.phase, last

    fast, slow = asks(7.0), asks(4.9)
    assert fast[0] is Phase.OVERRUN
    assert slow[0] is Phase.BRAKE
    # The engine brake stays active.
    assert slow[1].engine_brake > 0.9
    assert Powertrain(PARAMETERS).engine_brake_torque(110.0 * 4.9 / 5.0) > 0.0


def test_hard_braking_does_not_wait_for_a_gear_change():
    controller = LongitudinalController(PARAMETERS)
    changing = dataclasses.replace(LADEN, shift_in_process=True)
    run(controller, changing, plan(16.67, -4.0), 0.0, 0.1)
    assert controller.phase is Phase.BRAKE


def test_requests_grow_and_fall_at_their_rate():
    controller = LongitudinalController(PARAMETERS)
    steep = run(controller, LADEN, plan(16.67), -0.06, 2.0)
    climb = run(controller, LADEN, plan(16.67), 0.03, 2.0)
    requests = np.array([(c.engine_brake, c.retarder) for c in (*steep, *climb)])
    reach = controller.config.endurance_rate * CONTROL_PERIOD
    assert np.abs(np.diff(requests, axis=0)).max() <= reach + 1e-12
    assert requests[-1].max() == 0.0
    assert climb[-1].accelerator_pedal > 0.2


def test_a_stopped_truck_is_held_by_friction_and_launched_without_a_demand():
    controller = LongitudinalController(PARAMETERS)
    standing = dataclasses.replace(LADEN, speed=0.0, gear=2, engine_speed=62.8, engine_torque=0.0)
    held = run(controller, standing, plan(0.0), 0.05, 1.0)[-1]
    assert controller.phase is Phase.HOLD
    assert (held.xbr_mode, held.xbr_ebi_mode) == (XbrMode.MAXIMUM, XbrEbiMode.FRICTION_ONLY)
    launched = run(controller, standing, plan(0.5, 0.5), 0.05, 1.0)
    assert controller.phase is Phase.LAUNCH
    # An XBR demand would cut the engine: hill hold keeps the truck until the driveline does.
    assert all(command.xbr_mode is XbrMode.OFF for command in launched)
    assert launched[-1].accelerator_pedal > 0.1


def test_a_stopped_truck_is_held_before_it_starts_and_again_when_it_rolls_back():
    controller = LongitudinalController(PARAMETERS)
    standing = dataclasses.replace(LADEN, speed=0.0, gear=2, engine_speed=62.8, engine_torque=0.0)
    start = run(controller, standing, plan(0.5, 0.5), 0.10, 2.0)
    holding = [command.xbr_mode is XbrMode.MAXIMUM for command in start]
    assert holding[0]
    assert not holding[-1]
    assert sum(holding) == pytest.approx(controller.config.dwell / 0.02, abs=2)
    rolling = dataclasses.replace(standing, speed=-0.2)
    assert run(controller, rolling, plan(0.5, 0.5), 0.10, 0.02)[-1].xbr_mode is XbrMode.MAXIMUM


FAST = EgoState(mass=55_000.0, speed=20.0, gear=12, engine_speed=108.0, engine_torque=-130.0)


def coasting_grade(ego):
    """The grade on which the engine's drag alone holds the truck's speed."""
    inverse = Powertrain(PARAMETERS)
    drag = inverse.endurance(ego.speed, ego.engine_speed, ego.gear, True).drag
    level = inverse.resistance(ego.mass, ego.speed, 0.0)
    return -(level + drag) / (ego.mass * 9.81)


def settled(controller, ego, speed, grade):
    """Last command and phase after 3 s."""
    last = run(controller, ego, plan(speed), grade, 3.0)[-1]
    return controller.phase, last


def test_where_the_drag_is_enough_the_truck_coasts_and_ignores_small_errors():
    controller = LongitudinalController(PARAMETERS)
    grade = coasting_grade(FAST)
    controller.command(FAST, plan(19.9), grade)
    for error in (-0.15, -0.05, 0.0, 0.05, 0.15):
        phase, last = settled(controller, FAST, 20.0 + error, grade)
        assert phase is Phase.COAST
        assert (last.accelerator_pedal, last.engine_brake, last.retarder) == (0.0, 0.0, 0.0)


def test_coasting_ends_when_the_error_grows():
    for error, phase in ((0.5, Phase.DRIVE), (-0.5, Phase.OVERRUN)):
        controller = LongitudinalController(PARAMETERS)
        grade = coasting_grade(FAST)
        assert settled(controller, FAST, 19.9, grade)[0] is Phase.COAST
        found, last = settled(controller, FAST, 20.0 + error, grade)
        assert found is phase
        assert (last.accelerator_pedal > 0.0) == (phase is Phase.DRIVE)
        assert (last.engine_brake > 0.0) == (phase is Phase.OVERRUN)


def test_coasting_ignores_small_errors_except_at_walking_pace():
    config = LongitudinalConfig()
    assert coasting_error(config, 0.1, 20.0) == 0.0
    assert coasting_error(config, 0.1, 0.0) == 0.1


def test_braking_beyond_the_drag_uses_the_engine_brake_at_once():
    controller = LongitudinalController(PARAMETERS)
    phases = []
    for _ in range(100):
        controller.command(LADEN, plan(16.67), -0.04)
        phases.append(controller.phase)
    assert Phase.COAST not in phases
    assert phases[-1] is Phase.OVERRUN


def kicks_down(pedals):
    """Whether the gearbox, which low-pass filters the pedal, detects a kick-down."""
    shifting = PARAMETERS.gearbox.shifting
    slow, found = 0.0, False
    for pedal in pedals:
        found |= pedal >= shifting.kick_down_pedal and pedal - slow > shifting.kick_down_rise
        slow += 0.02 / shifting.pedal_lag * (pedal - slow)
    return found


@pytest.mark.parametrize(("gain", "wanted"), [(0.5, False), (6.0, True)])
def test_the_pedal_kicks_down_only_for_a_large_gain_of_speed(gain, wanted):
    controller = LongitudinalController(PARAMETERS)
    climbing = dataclasses.replace(FAST, engine_torque=1_500.0)
    commands = run(controller, climbing, plan(FAST.speed + gain), 0.03, 8.0)
    pedals = [command.accelerator_pedal for command in commands]
    assert kicks_down(pedals) is wanted
    # The pedal reaches full power nevertheless, a little later.
    assert pedals[-1] == 1.0


def test_the_pedal_also_gives_the_torque_of_the_auxiliaries():
    ego = dataclasses.replace(LADEN, engine_torque=900.0)
    pedals = []
    for power in (0.0, 20e3):
        controller = LongitudinalController(PARAMETERS)
        numbers = np.frombuffer(controller._powertrain).copy()
        numbers[6] = power
        controller._powertrain = numbers.tobytes()
        pedals.append(run(controller, ego, plan(16.67), 0.0, 2.0)[-1].accelerator_pedal)
    inverse = Powertrain(PARAMETERS)
    torques = np.linspace(0.0, 1500.0, 1501)
    needed = np.array([inverse.pedal(torque, ego.engine_speed) for torque in torques])
    given = np.interp(pedals, needed, torques)
    assert np.diff(given) == pytest.approx(20e3 / ego.engine_speed, rel=0.02)
