"""Speed tracking step by step: phases, rates, the integral, the start, and the forces."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.tracking.controller import Tracker
from controllers.tracking.longitudinal import LongitudinalConfig, Phase
from iits_mj.core.messages import EgoState, XbrEbiMode, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.tracking.reference import Actuation, EnduranceForces, Powertrain
from tests.controllers.tracking.speed_reference import (
    KickDown,
    SpeedLaw,
    SpeedView,
    coasting_error,
)
from tests.controllers.tracking.test_longitudinal import LADEN, plan, run

PARAMETERS = TruckParameters.load()
INVERSE = Powertrain(PARAMETERS)
CONFIG = LongitudinalConfig()
GEARBOX, ENGINE = PARAMETERS.gearbox, PARAMETERS.engine


@pytest.fixture
def controller():
    return SpeedLaw(PARAMETERS)


# --- the plan -------------------------------------------------------------------------------


def test_the_plan_is_looked_up_by_time():
    view = SpeedView(plan(10.0, 0.5))
    assert view.greatest == 12.5
    assert view.speed(1.25) == pytest.approx(10.625)
    assert view.acceleration(9.0) == 0.5
    assert (view.speed(-1.0), view.speed(9.0)) == (10.0, 12.5)


def test_coasting_ignores_a_band_that_shrinks_below_its_speed():
    band = CONFIG.coast_error
    for error in (-0.5, -0.1, 0.1, 0.5):
        assert coasting_error(CONFIG, error, 20.0) == pytest.approx(
            math.copysign(max(abs(error) - band, 0.0), error), abs=1e-12
        )
    half = 0.5 * CONFIG.coast_speed
    assert coasting_error(CONFIG, 0.3, half) == pytest.approx(0.3 - 0.5 * band)
    assert coasting_error(CONFIG, 0.3, -5.0) == 0.3


# --- kick-down ------------------------------------------------------------------------------


def test_the_pedal_without_a_kick_down_rises_with_its_recent_level():
    shifting = PARAMETERS.gearbox.shifting
    kick_down = KickDown(PARAMETERS)
    near_floor, rise = 0.99 * shifting.kick_down_pedal, 0.99 * shifting.kick_down_rise
    assert kick_down.greatest_pedal == pytest.approx(max(near_floor, rise))
    slow, share = 0.0, CONTROL_PERIOD / shifting.pedal_lag
    for _ in range(round(4.0 * shifting.pedal_lag / CONTROL_PERIOD)):
        kick_down.follow(0.9)
        slow += share * (0.9 - slow)
    assert kick_down.greatest_pedal == pytest.approx(min(max(near_floor, slow + rise), 1.0))
    kick_down.reset()
    assert kick_down.greatest_pedal == pytest.approx(max(near_floor, rise))


# --- phases ---------------------------------------------------------------------------------

D, C, O, B = Phase.DRIVE, Phase.COAST, Phase.OVERRUN, Phase.BRAKE  # noqa: E741
ENTER, LEAVE = CONFIG.overrun_enter, CONFIG.overrun_leave


@pytest.mark.parametrize(
    ("phase", "above", "beyond", "deficit", "wanted", "expected"),
    [
        # Driving ends when the torque falls well below the drag, and goes on for a little less.
        (D, -0.9 * ENTER, 0.0, 0.0, 0.0, D),
        (D, -1.1 * ENTER, 0.0, 0.0, 0.0, C),
        (D, -1.1 * ENTER, 1.1 * CONFIG.retard_enter, 0.0, 0.0, O),
        (D, 500.0, 0.0, 1.1 * CONFIG.brake_enter, 0.0, B),
        (D, 500.0, 0.0, 0.9 * CONFIG.brake_enter, 0.0, D),
        (D, 500.0, 0.0, 0.0, -1.01, B),
        # Coasting.
        (C, 0.9 * LEAVE, 0.0, 0.0, 0.0, C),
        (C, 1.1 * LEAVE, 0.0, 0.0, 0.0, D),
        (C, -500.0, 0.9 * CONFIG.retard_enter, 0.0, 0.0, C),
        (C, -500.0, 1.1 * CONFIG.retard_enter, 0.0, 0.0, O),
        # Endurance brakes.
        (O, -10.0, 1.0, 0.0, 0.0, O),
        (O, 10.0, 0.0, 0.0, 0.0, C),
        (O, 0.9 * LEAVE, 0.0, 0.0, 0.0, C),
        (O, 1.1 * LEAVE, 0.0, 0.0, 0.0, D),
        (O, -10.0, 1.0, 1.1 * CONFIG.brake_enter, 0.0, B),
        # Friction.
        (B, -500.0, 1.0, 1.1 * CONFIG.brake_leave, 0.0, B),
        (B, -500.0, 1.0, 0.9 * CONFIG.brake_leave, -0.9, B),
        (B, -500.0, 1.0, 0.9 * CONFIG.brake_leave, -0.7, O),
        (B, 1.1 * LEAVE, 0.0, 0.0, 0.0, D),
        (B, 0.9 * LEAVE, 0.0, 0.0, 0.0, O),
        # From standstill the truck drives.
        (Phase.LAUNCH, 500.0, 0.0, 0.0, 0.0, D),
        (Phase.HOLD, 500.0, 0.0, 0.0, 0.0, D),
    ],
)
def test_the_next_phase_follows_from_the_wanted_torque(
    controller, phase, above, beyond, deficit, wanted, expected
):
    controller.phase = phase
    controller._choose(above, beyond, deficit, wanted, engaged=True)
    assert controller.phase is expected


def test_a_phase_lasts_for_its_dwell_time_and_over_a_gear_change(controller):
    controller._choose(-500.0, 0.0, 0.0, 0.0, engaged=False)
    assert controller.phase is Phase.DRIVE
    controller._choose(-500.0, 0.0, 0.0, 0.0, engaged=True)
    assert (controller.phase, controller._since) == (Phase.COAST, 0.0)
    controller._since = 0.99 * CONFIG.dwell
    controller._choose(500.0, 0.0, 0.0, 0.0, engaged=True)
    assert controller.phase is Phase.COAST
    controller._since = CONFIG.dwell
    controller._choose(500.0, 0.0, 0.0, 0.0, engaged=True)
    assert controller.phase is Phase.DRIVE
    # Hard braking waits for nothing.
    controller._choose(500.0, 0.0, 0.0, -1.1, engaged=False)
    assert controller.phase is Phase.BRAKE
    controller.reset()
    assert (controller.phase, controller._since) == (Phase.DRIVE, CONFIG.dwell)


@pytest.mark.parametrize(
    ("phase", "speed", "planned", "soon", "stands"),
    [
        (D, 0.24, 0.0, 0.1, True),
        (D, 0.26, 0.0, 0.0, False),
        (D, 0.2, 0.0, 0.2, False),
        (D, 0.2, 0.2, 0.0, False),
        (D, 0.2, 0.15, 0.15, True),
        (D, 0.04, 1.0, 1.0, True),
        (D, 0.06, 1.0, 1.0, False),
        (D, -0.04, 1.0, 1.0, True),
        (D, -0.06, 1.0, 1.0, False),
        (Phase.HOLD, 0.24, 1.0, 1.0, True),
        (Phase.LAUNCH, 0.26, 1.0, 1.0, False),
        (Phase.LAUNCH, 0.26, 1.0, 0.15, True),
    ],
)
def test_the_truck_stands_until_its_plan_and_its_speed_leave_standstill(
    controller, phase, speed, planned, soon, stands
):
    controller.phase = phase
    assert controller._stand(EgoState(speed=speed), planned, soon) is stands


@pytest.mark.parametrize(
    ("phase", "since", "speed", "grade", "starts"),
    [
        (Phase.LAUNCH, 0.0, 0.0, 0.1, True),
        (Phase.LAUNCH, 0.0, -0.09, 0.1, True),
        (Phase.LAUNCH, 0.0, -0.11, 0.1, False),
        (Phase.HOLD, 0.59, 0.0, 0.02, False),
        (Phase.HOLD, 0.6, 0.0, 0.02, True),
        (D, 9.0, 0.0, 0.02, False),
        (D, 0.0, 0.0, 0.009, True),
        (D, 0.0, 0.0, 0.01, False),
    ],
)
def test_uphill_a_start_needs_a_hold(controller, phase, since, speed, grade, starts):
    controller.phase, controller._since = phase, since
    assert controller._may_start(EgoState(speed=speed), grade) is starts


# --- actuators ------------------------------------------------------------------------------


def test_the_pedal_rises_and_falls_at_its_rates(controller):
    pedals = []
    for wanted in [1.0] * 30 + [0.0] * 30:
        controller._pull(LADEN, wanted, gain=9.0)
        pedals.append(controller._pedal)
    steps = np.diff([0.0, *pedals])
    assert steps[:20] == pytest.approx(np.full(20, CONFIG.pedal_rise * CONTROL_PERIOD))
    assert steps[31:40] == pytest.approx(np.full(9, -CONFIG.pedal_fall * CONTROL_PERIOD))
    assert pedals[-1] == pytest.approx(0.0, abs=1e-9)


def test_the_pedal_rests_in_a_gear_change_and_is_released_in_other_phases(controller):
    controller._pedal = 0.4
    controller._pull(dataclasses.replace(LADEN, shift_in_process=True), 1.0, gain=9.0)
    assert controller._pedal == 0.4
    controller.phase = Phase.COAST
    controller._pull(LADEN, 1.0, gain=9.0)
    assert controller._pedal == 0.0


@pytest.mark.parametrize(("gain", "kicks"), [(1.9, False), (2.0, True)])
def test_only_a_large_gain_of_speed_lifts_the_bound_on_the_pedal(controller, gain, kicks):
    controller._pedal = 0.99
    controller._pull(LADEN, 1.0, gain)
    assert (controller._pedal == 1.0) is kicks


def test_endurance_requests_change_at_their_rate_and_rest_without_them(controller):
    reach = CONFIG.endurance_rate * CONTROL_PERIOD
    controller.phase = Phase.OVERRUN
    controller._retard(Actuation(engine_brake=1.0, retarder=0.5 * reach), -0.2, engaged=True)
    assert controller._engine_brake == pytest.approx(reach)
    assert controller._retarder == pytest.approx(0.5 * reach)
    # A gear change keeps the request of the engine brake.
    controller._retard(Actuation(engine_brake=0.0, retarder=1.0), -0.2, engaged=False)
    assert controller._engine_brake == pytest.approx(reach)
    assert controller._retarder == pytest.approx(1.5 * reach)
    # At exactly the urgent deceleration they still work; beyond it brake control commands them.
    controller._retard(Actuation(engine_brake=1.0, retarder=1.0), -CONFIG.urgent, engaged=True)
    assert controller._engine_brake == pytest.approx(2.0 * reach)
    controller._retard(
        Actuation(engine_brake=1.0, retarder=1.0), -1.1 * CONFIG.urgent, engaged=True
    )
    assert controller._engine_brake == pytest.approx(reach)
    for phase in (Phase.DRIVE, Phase.COAST):
        controller._engine_brake = controller._retarder = 0.5
        controller.phase = phase
        controller._retard(Actuation(engine_brake=1.0, retarder=1.0), 0.0, engaged=True)
        assert controller._engine_brake == pytest.approx(0.5 - reach)
        assert controller._retarder == pytest.approx(0.5 - reach)


def demands(controller, force, wanted, steps):
    found = []
    for _ in range(steps):
        controller._brake(LADEN.mass, force, wanted)
        found.append(controller._demand)
    return found


def test_the_brake_demand_rises_at_its_rate_and_falls_at_once(controller):
    controller.phase = Phase.BRAKE
    gentle = demands(controller, -55_000.0 * 2.0, -2.0, 60)
    assert np.diff([0.0, *gentle])[:20] == pytest.approx(
        np.full(20, CONFIG.demand_rate * CONTROL_PERIOD)
    )
    brake = PARAMETERS.air_brake
    level = 55_000.0 * (2.0 + GRAVITY * INVERSE.rolling) / (55_000.0 + INVERSE.wheel_mass)
    least = max(0.5 * level, (level - brake.trim_max) / (1.0 + brake.trim_share))
    assert gentle[-1] == pytest.approx(max(2.0, least))
    controller.phase = Phase.OVERRUN
    assert demands(controller, -55_000.0 * 2.0, -2.0, 1) == [0.0]
    controller.phase = Phase.BRAKE
    hard = demands(controller, -55_000.0 * 3.0, -3.0, 3)
    assert hard[0] == pytest.approx(10.0 * CONTROL_PERIOD)
    assert demands(controller, -55_000.0 * 12.0, -12.0, 100)[-1] == CONFIG.demand_max
    # While friction is used the demand stays active, however small.
    assert demands(controller, 9e5, 1.0, 1) == [1e-3]


def learned(controller, error, speed=10.0, **fields):
    values = {"_pedal": 0.5, "_demand": 0.0, "_engine_brake": 0.0, "_retarder": 0.0}
    values |= {"_integral": 0.0, "phase": Phase.DRIVE} | fields
    shifting = values.pop("shifting", False)
    for name, value in values.items():
        setattr(controller, name, value)
    controller._learn(EgoState(speed=speed, shift_in_process=shifting), error)
    return controller._integral


def test_the_integral_grows_with_the_error_and_is_bounded(controller):
    step = CONFIG.integral_gain * 0.4 * CONTROL_PERIOD
    assert learned(controller, 0.4) == pytest.approx(step)
    assert learned(controller, -0.4) == pytest.approx(-step)
    assert learned(controller, 0.4, speed=1.0) == pytest.approx(step)
    for side in (-1.0, 1.0):
        near = side * (CONFIG.integral_max - 1e-6)
        assert learned(controller, 5.0 * side, _integral=near) == side * CONFIG.integral_max


@pytest.mark.parametrize(
    ("error", "fields", "rests"),
    [
        (0.4, {"_pedal": 1.0}, True),
        (-0.4, {"_pedal": 1.0}, False),
        (0.4, {"_pedal": 0.99}, False),
        (-0.4, {"_demand": CONFIG.demand_max, "phase": Phase.BRAKE}, True),
        (0.4, {"_demand": CONFIG.demand_max, "phase": Phase.BRAKE}, False),
        (-0.4, {"_demand": 0.9 * CONFIG.demand_max, "phase": Phase.BRAKE}, False),
        (0.4, {"phase": Phase.COAST}, True),
        (-0.4, {"phase": Phase.OVERRUN}, True),
        (0.4, {"phase": Phase.OVERRUN}, False),
        (-0.4, {"phase": Phase.OVERRUN, "_engine_brake": 0.1}, False),
        (-0.4, {"phase": Phase.OVERRUN, "_retarder": 0.1}, False),
        (0.4, {"shifting": True}, True),
        (0.4, {"speed": 0.99}, True),
    ],
)
def test_the_integral_rests_where_the_truck_cannot_follow_it(controller, error, fields, rests):
    assert (learned(controller, error, **fields) == 0.0) is rests


def test_the_command_is_within_the_ranges_of_its_signals(controller):
    controller._pedal, controller._engine_brake, controller._retarder = 1.4, -0.2, 1.3
    command = controller._output(0.5)
    assert (command.accelerator_pedal, command.engine_brake, command.retarder) == (1.0, 0.0, 1.0)
    assert (command.xbr_mode, command.xbr_demand) == (XbrMode.OFF, 0.0)
    controller._pedal, controller._engine_brake, controller._retarder = -0.4, 1.2, -0.3
    controller._demand = 0.7
    command = controller._output(0.5)
    assert (command.accelerator_pedal, command.engine_brake, command.retarder) == (0.0, 1.0, 0.0)
    assert (command.xbr_mode, command.xbr_demand) == (XbrMode.MAXIMUM, -0.7)
    assert command.xbr_ebi_mode is XbrEbiMode.FRICTION_ONLY
    controller.phase = Phase.BRAKE
    assert controller._output(0.5).xbr_ebi_mode is XbrEbiMode.INTEGRATION


def test_a_start_uses_the_pedal_for_a_gentle_pull_and_releases_the_brakes(controller):
    standing = dataclasses.replace(LADEN, speed=0.0, gear=2, engine_speed=62.8)
    controller._integral = 0.3
    held = controller.command(standing, plan(0.0), 0.06)
    assert (held.xbr_demand, held.accelerator_pedal) == (-CONFIG.hold_demand, 0.0)
    assert controller._integral == 0.0
    launched = run(controller, standing, plan(0.5, 0.5), 0.06, 3.0)
    pull = 0.35 * LADEN.mass + INVERSE.resistance(LADEN.mass, 0.1, 0.06)
    target = INVERSE.pedal(INVERSE.engine_torque(pull, 2), 70.0)
    assert launched[-1].accelerator_pedal == pytest.approx(max(target, 0.12))
    pedals = [0.0, *(command.accelerator_pedal for command in launched)]
    assert np.diff(pedals).max() == pytest.approx(CONFIG.pedal_rise * CONTROL_PERIOD)
    controller.reset()
    level = run(controller, dataclasses.replace(standing, mass=19_000.0), plan(0.5, 0.5), 0.0, 1.0)
    assert level[-1].accelerator_pedal >= 0.12
    assert controller.phase is Phase.LAUNCH


def test_the_demanded_force_is_that_of_plan_error_and_integral(controller):
    """Newton's law through the driveline gives the pedal of a truck that has settled."""
    ego = dataclasses.replace(LADEN, speed=15.0, gear=9, engine_speed=150.0)
    trajectory = plan(15.2, 0.1)
    last = run(controller, ego, trajectory, 0.01, 1.0)[-1]
    wanted = 0.1 + CONFIG.speed_gain * 0.2 + controller._integral
    wanted -= CONFIG.integral_gain * 0.2 * CONTROL_PERIOD
    force = INVERSE.effective_mass(55_000.0, 9) * wanted
    force += INVERSE.resistance(55_000.0, 15.0, 0.01)
    expected = INVERSE.pedal(INVERSE.engine_torque(force, 9), 150.0)
    assert 0.1 < expected < 0.95
    assert last.accelerator_pedal == pytest.approx(expected)
    # The plan is taken earlier by the lead time.
    rising = dataclasses.replace(trajectory, acceleration=0.1 * trajectory.time)
    controller.reset()
    controller._pedal = expected
    run(controller, ego, rising, 0.01, 1.0)
    ahead = 0.1 * CONFIG.lead_time + CONFIG.speed_gain * 0.2 + controller._integral
    ahead -= CONFIG.integral_gain * 0.2 * CONTROL_PERIOD
    force = INVERSE.effective_mass(55_000.0, 9) * ahead
    force += INVERSE.resistance(55_000.0, 15.0, 0.01)
    pedal = INVERSE.pedal(INVERSE.engine_torque(force, 9), 150.0)
    assert controller._pedal == pytest.approx(pedal)


def lacking(force, speed, engine_speed, soon, engaged=True):
    """Force that the controller's inverse lacks in sixth gear [N]."""
    return INVERSE.actuation(force, speed, engine_speed, 6, engaged, soon).lacking


def test_friction_that_will_be_missing_soon_is_judged_at_the_speed_after_its_build_up(controller):
    later = 6.0 - 1.5 * CONFIG.build_up
    forces = INVERSE.endurance(later, 110.0 * later / 6.0, 6, engaged=True)
    assert lacking(-sum(forces) - 3000.0, 6.0, 110.0, later) == pytest.approx(3000.0)
    # In a gear change the engine does not brake.
    now = INVERSE.endurance(6.0, 110.0, 6, engaged=True)
    assert lacking(-sum(now) - 500.0, 6.0, 110.0, 6.0) == pytest.approx(500.0)
    assert lacking(-now.retarder - 700.0, 6.0, 110.0, 6.0, False) == pytest.approx(700.0)
    assert lacking(-4000.0, 0.05, 110.0, 0.0) > 0.0
    # The controller looks ahead by the speed that it wants to lose.
    ego = EgoState(mass=19_000.0, speed=6.0, gear=6, engine_speed=110.0)
    seen = []
    controller.inverse.actuation = lambda *asked: seen.append(asked) or INVERSE.actuation(*asked)
    for wanted in (-1.5, 1.0):
        controller.reset()
        controller.command(ego, plan(6.0, wanted), 0.0)
    assert [asked[-1] for asked in seen] == pytest.approx([later, 6.0])


# --- forces ---------------------------------------------------------------------------------


@pytest.mark.parametrize("grade", [-0.06, 0.0, 0.08])
def test_the_resistance_is_slope_rolling_and_air(grade):
    slope, air = math.atan(grade), PARAMETERS.aerodynamics
    rolling = PARAMETERS.tires["drive"].rolling_resistance
    drag = 0.5 * air.density * air.drag_area
    weight = 40_000.0 * GRAVITY
    expected = weight * (math.sin(slope) + rolling * math.cos(slope)) + drag * 20.0**2
    assert INVERSE.resistance(40_000.0, 20.0, grade) == pytest.approx(expected)
    assert INVERSE.resistance(40_000.0, 0.05, grade) == pytest.approx(
        weight * math.sin(slope) + drag * 0.05**2
    )
    back = INVERSE.resistance(40_000.0, -3.0, grade)
    assert back == pytest.approx(weight * math.sin(slope) - drag * 9.0)


def test_the_effective_mass_has_the_energy_of_wheels_engine_and_gearbox():
    radius = PARAMETERS.tires[PARAMETERS.lead.axles[-1].tire].rolling_radius
    for gear in (1, 5, 12):
        ratio = float(GEARBOX.ratios[gear - 1]) * GEARBOX.final_drive
        turning = ENGINE.inertia + float(GEARBOX.inertias[gear - 1])
        wheels = sum(
            2.0 * axle.wheel_inertia_spin / PARAMETERS.tires[axle.tire].rolling_radius ** 2
            for axle in PARAMETERS.axles
        )
        expected = 30_000.0 + wheels + turning * (ratio / radius) ** 2
        assert INVERSE.effective_mass(30_000.0, gear) == pytest.approx(expected)
        assert INVERSE.ratio(gear) == ratio
    assert INVERSE.ratio(-1) == INVERSE.ratio(0) == INVERSE.ratio(1)
    assert INVERSE.ratio(99) == INVERSE.ratio(len(GEARBOX.ratios))


def test_losses_help_the_engine_to_brake_and_hinder_it_to_pull():
    losses = GEARBOX.efficiency * GEARBOX.driveline_efficiency
    lever = INVERSE.radius / INVERSE.ratio(8)
    assert INVERSE.engine_torque(20e3, 8) == pytest.approx(20e3 * lever / losses)
    assert INVERSE.engine_torque(-20e3, 8) == pytest.approx(-20e3 * lever * losses)
    forces = INVERSE.endurance(15.0, 150.0, 8, engaged=True)
    assert forces.drag == pytest.approx(INVERSE.drag_torque(150.0) / lever / losses)
    assert forces.engine_brake == pytest.approx(INVERSE.engine_brake_torque(150.0) / lever / losses)
    shaft = GEARBOX.final_drive / INVERSE.radius
    retarder = INVERSE.retarder_torque(15.0 * shaft) * shaft / GEARBOX.driveline_efficiency
    assert forces.retarder == pytest.approx(retarder)
    assert INVERSE.endurance(15.0, 150.0, 8, False) == EnduranceForces(0.0, 0.0, retarder)


def test_the_engine_brake_fades_in_above_its_least_speed_and_follows_its_power_law():
    least, fade = ENGINE.engine_brake_speed_min, ENGINE.engine_brake_fade
    rated = ENGINE.engine_brake_power / ENGINE.engine_brake_speed

    def law(speed):
        return rated * (speed / ENGINE.engine_brake_speed) ** (ENGINE.engine_brake_exponent - 1.0)

    assert INVERSE.engine_brake_torque(least) == 0.0
    half = least + 0.5 * fade
    assert INVERSE.engine_brake_torque(half) == pytest.approx(0.5 * law(half))
    assert INVERSE.engine_brake_torque(200.0) == pytest.approx(law(200.0))


def test_the_retarder_has_a_rise_a_greatest_torque_and_a_greatest_power():
    retarder = PARAMETERS.retarder
    assert INVERSE.retarder_torque(0.0) == INVERSE.retarder_torque(-5.0) == 0.0
    half = 0.5 * retarder.full_torque_speed
    assert INVERSE.retarder_torque(half) == pytest.approx(0.25 * retarder.torque_max)
    fast = 3.0 * retarder.power_max / retarder.torque_max
    assert INVERSE.retarder_torque(fast) == pytest.approx(retarder.power_max / fast)


def test_the_grade_is_the_mean_of_both_units_weighted_by_their_mass():
    tracker = Tracker(Route.straight(length=500.0), PARAMETERS)
    tractor, trailer = PARAMETERS.lead, PARAMETERS.units[1]
    hill = {"at": 200.0}
    tracker.route = type(
        "Hill", (), {"smoothed_grade": staticmethod(lambda s: 1e-3 * (s - hill["at"]))}
    )()
    ego = EgoState(station=260.0, mass=40_000.0)
    share = tractor.mass / 40_000.0
    behind = PARAMETERS.couplings[0].position + trailer.cg_position
    expected = 60.0 - share * tractor.cg_position - (1.0 - share) * behind
    assert tracker.grade(ego) == pytest.approx(1e-3 * expected)
    empty = dataclasses.replace(ego, mass=PARAMETERS.gross_mass(0.0))
    light = dataclasses.replace(ego, mass=1.0)
    assert tracker.grade(light) == tracker.grade(empty)


def test_a_reset_of_the_tracker_clears_both_controllers():
    tracker = Tracker(Route.straight(length=500.0), PARAMETERS)
    speed, path = tracker.longitudinal, tracker.lateral
    speed.memory.demand, path.memory.error = 2.0, 0.5
    speed.memory.phase = list(Phase).index(Phase.BRAKE)
    assert speed.phase is Phase.BRAKE
    tracker.reset()
    assert speed.phase is Phase.DRIVE
    assert (speed.memory.demand, path.error) == (0.0, 0.0)
