import dataclasses

import numpy as np
import pytest

from iits_mj.analytic import (
    YawPlane,
    YawRoll,
    cruise_axle_loads,
    simulate,
    step_response,
    yaw_rate_gain,
)
from iits_mj.analytic.roll_bodies import RollData, relaxation_lengths, roll_bodies
from iits_mj.analytic.traction import lead_pitch
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import laden_units, static_axle_loads
from iits_mj.truck import Truck
from iits_mj.validation.handling.step_steer import free_couplings, step_steers
from iits_mj.validation.harness.recorder import fit, run_straight

PARAMETERS = TruckParameters.load()
V80 = 80.0 / 3.6
EFFECTS = ("roll", "relaxation", "side_air", "wheels", "traction")
PAYLOADS = (0.0, 36_000.0)


def _model(payload, *effects, parameters=PARAMETERS, **more):
    """The model with only the effects named."""
    switches = {effect: effect in effects for effect in EFFECTS}
    return YawRoll.from_parameters(parameters, payload, **switches, **more)


PHI_C, PHI_T, FIRST_AXLE = 3, 4, 5


def _bodies(payload, coupling=None, parameters=PARAMETERS):
    """Data and matrices of roll, with another roll stiffness of the coupling [N m/rad]."""
    plane = YawPlane.from_parameters(parameters, payload)
    data = RollData.from_parameters(parameters, payload)
    if coupling is not None:
        data = dataclasses.replace(data, coupling_stiffness=np.array([coupling]))
    return data, roll_bodies(plane, data)


def _step(model):
    return step_response(model.at(V80), 0.01)


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("trail", [True, False])
@pytest.mark.parametrize("cruise_speed", [0.0, V80])
def test_without_its_effects_the_model_equals_the_yaw_sideslip_model(payload, trail, cruise_speed):
    options = {"pneumatic_trail": trail, "cruise_speed": cruise_speed}
    plane = YawPlane.from_parameters(PARAMETERS, payload, **options).at(V80)
    system = _model(payload, **options).at(V80)
    np.testing.assert_allclose(system.A, plane.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.B, plane.B, rtol=1e-12)
    assert system.states == plane.states
    mine, other = step_response(system, 0.01), step_response(plane, 0.01)
    for field in dataclasses.fields(mine):
        np.testing.assert_allclose(
            getattr(mine, field.name), getattr(other, field.name), atol=1e-12
        )


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_changes_the_response(payload, effect):
    plane = _step(_model(payload, cruise_speed=V80))
    with_effect = _step(_model(payload, effect, cruise_speed=V80))
    change = np.abs(with_effect.yaw_rate - plane.yaw_rate).max()
    assert 1e-4 < change / np.abs(plane.yaw_rate).max() < 0.2


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("coupling", [None, 0.0])
def test_truck_with_roll_is_stable_at_80_kmh(payload, coupling):
    model = YawRoll.from_parameters(PARAMETERS, payload, cruise_speed=V80, roll_coupling=coupling)
    system = model.at(V80)
    assert system.stable
    assert 0.05 < system.damping_ratio() < 0.5


@pytest.mark.parametrize("payload", PAYLOADS)
def test_masses_and_roll_inertia_are_those_of_the_parameters(payload):
    _, bodies = _bodies(payload, 0.0)
    trailer, tractor = laden_units(PARAMETERS, payload)[1], PARAMETERS.lead
    assert bodies.inertia[0, 0] == pytest.approx(tractor.mass + trailer.mass, rel=1e-12)
    # Common roll about the road: Steiner's sum, for any split into bodies and axles.
    together = np.zeros(len(bodies.inertia))
    together[PHI_C:] = 1.0
    about_road = tractor.inertia_x + tractor.mass * tractor.cg_height**2
    about_road += trailer.inertia_x + trailer.mass * trailer.cg_height**2
    assert together @ bodies.inertia @ together == pytest.approx(about_road, rel=1e-9)
    assert bodies.inertia[0] @ together == pytest.approx(
        -tractor.mass * tractor.cg_height - trailer.mass * trailer.cg_height, rel=1e-12
    )


@pytest.mark.parametrize("payload", PAYLOADS)
def test_tipping_about_the_road_takes_weight_times_height(payload):
    # A truck that rolls as one about the road's middle is held by its tires: their springs, and
    # their loads at the wheel centers.
    data, bodies = _bodies(payload, 1e6)
    together = np.zeros(len(bodies.stiffness))
    together[PHI_C:] = 1.0
    trailer, tractor = laden_units(PARAMETERS, payload)[1], PARAMETERS.lead
    weight = tractor.mass * tractor.cg_height + trailer.mass * trailer.cg_height
    loads = static_axle_loads(PARAMETERS, payload)
    tires = [PARAMETERS.tires[axle.tire] for axle in PARAMETERS.axles]
    centers = [
        tire.free_radius - load / (2 * tire.count * tire.vertical_stiffness)
        for tire, load in zip(tires, loads, strict=True)
    ]
    expected = data.tires.sum() + loads @ centers - weight * GRAVITY
    assert together @ bodies.stiffness @ together == pytest.approx(expected, rel=1e-9)


def _stiff_truck(roll_center):
    """A truck on rigid tires with all roll centers at this height [m]."""
    tires = {
        kind: dataclasses.replace(tire, vertical_stiffness=1e13)
        for kind, tire in PARAMETERS.tires.items()
    }

    def unit(figures):
        axles = [
            dataclasses.replace(axle, roll_center_height=roll_center - tires[axle.tire].free_radius)
            for axle in figures.axles
        ]
        return dataclasses.replace(figures, axles=tuple(axles))

    tractor, trailer = unit(PARAMETERS.lead), unit(PARAMETERS.units[1])
    return dataclasses.replace(PARAMETERS, tires=tires, units=(tractor, trailer))


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("roll_center", [0.0, 0.7])
def test_units_that_roll_as_one_have_the_roll_of_hand_statics(payload, roll_center):
    truck = _stiff_truck(roll_center)
    system = _model(payload, "roll", parameters=truck, roll_coupling=1e11).at(V80)
    state = system.steady_state(1e-3)
    acceleration = V80 * state[1]
    # phi (K - m_s g l) = m_s l a, with l the sprung masses' height above the roll axis.
    stiffness = sum(
        0.5 * axle.spring_rate * axle.spring_spacing**2 + axle.auxiliary_roll_stiffness
        for axle in truck.axles
    )
    moment = sum(
        body.mass * (body.cg_height - roll_center)
        for body in (truck.lead, laden_units(truck, payload)[1])
    )
    moment -= sum(
        axle.unsprung_mass * (truck.tires[axle.tire].free_radius - roll_center)
        for axle in truck.axles
    )
    expected = moment * acceleration / (stiffness - moment * GRAVITY)
    assert system.roll_angles(state[None, :])[0] == pytest.approx([expected] * 2, rel=1e-4)


def _modes(system):
    """Frequencies [Hz] and damping ratios of the oscillating modes."""
    values = system.eigenvalues()
    values = values[values.imag > 0.0]
    return np.abs(values) / (2.0 * np.pi), -values.real / np.abs(values)


@pytest.mark.parametrize(("payload", "band"), [(36_000.0, (0.8, 1.6)), (0.0, (2.0, 3.5))])
def test_roll_mode_lies_in_the_band_of_real_trucks(payload, band):
    with_roll, _ = _modes(_model(payload, "roll").at(V80))
    in_band = with_roll[(with_roll > band[0]) & (with_roll < band[1])]
    assert len(in_band) == 1
    without, _ = _modes(_model(payload).at(V80))
    assert not np.any((without > band[0]) & (without < band[1]))


def test_truck_with_a_high_payload_rolls_more():
    load = PARAMETERS.units[1].payload
    high = PARAMETERS.with_payload_height(load.cg_height_max)
    low = PARAMETERS.with_payload_height(load.cg_height_min)
    gains = []
    for parameters in (low, high):
        system = YawRoll.from_parameters(parameters, 36_000.0).at(V80)
        rolls = system.roll_angles(system.steady_state()[None, :])
        gains.append(float(rolls[0, 1] / system.steady_state()[1]))
    assert 0.0 < 1.3 * gains[0] < gains[1]


def test_trailer_rolls_more_than_a_tractor_that_does_not_hold_it():
    free = YawRoll.from_parameters(PARAMETERS, 36_000.0, roll_coupling=0.0).at(V80)
    held = YawRoll.from_parameters(PARAMETERS, 36_000.0).at(V80)
    ((free_tractor, free_trailer),) = free.roll_angles(free.steady_state()[None, :])
    ((held_tractor, held_trailer),) = held.roll_angles(held.steady_state()[None, :])
    assert free_trailer > held_trailer > held_tractor > free_tractor > 0.0


def test_relaxation_adds_the_phase_lag_of_sigma_over_speed():
    # Equal lag of all tires: a short lag delays all forces by sigma / v.
    frequency = np.array([0.05])
    common = dataclasses.replace(
        PARAMETERS.tire_common, relaxation_lateral=0.4, relaxation_load_exponent=0.0
    )
    parameters = dataclasses.replace(PARAMETERS, tire_common=common)
    lagging = _model(36_000.0, "relaxation", parameters=parameters).at(V80)
    direct = _model(36_000.0).at(V80)
    slips = [name.startswith("slip") for name in lagging.states]
    states = lagging.frequency_response(frequency)[0]
    omega = 2.0 * np.pi * frequency[0]
    model = lagging.model
    slip = 1.0 - (states[0] + model.reference * states[1]) / V80
    lag = np.angle(slip) - np.angle(states[np.flatnonzero(slips)[0]])
    assert lag == pytest.approx(omega * 0.4 / V80, rel=1e-4)
    assert np.angle(states[1]) < np.angle(direct.frequency_response(frequency)[0, 1])


def test_relaxation_length_grows_with_load_above_its_minimum():
    common = PARAMETERS.tire_common
    tires = np.array([2 * PARAMETERS.tires[axle.tire].count for axle in PARAMETERS.axles])
    at_nominal = relaxation_lengths(PARAMETERS, PARAMETERS.axles, tires * common.nominal_load)
    np.testing.assert_allclose(at_nominal, common.relaxation_lateral)
    half = relaxation_lengths(PARAMETERS, PARAMETERS.axles, 0.5 * tires * common.nominal_load)
    np.testing.assert_allclose(half / at_nominal, 0.5**common.relaxation_load_exponent)
    assert np.all(relaxation_lengths(PARAMETERS, PARAMETERS.axles, np.zeros(6)) > 0.0)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_side_air_resists_sideslip(payload):
    # In a steady turn the bodies slip outward at the rear; air there helps the rear tires.
    calm = _model(payload, cruise_speed=V80).at(V80)
    windy = _model(payload, "side_air", cruise_speed=V80).at(V80)
    state = np.array([1.0, 0.0, 0.0, 0.0])
    assert (windy.A @ state - calm.A @ state)[0] < 0.0
    assert yaw_rate_gain(windy) != pytest.approx(yaw_rate_gain(calm), rel=1e-3)


def test_rolling_resistance_of_the_outer_wheels_turns_out_of_the_bend():
    parameters = dataclasses.replace(
        PARAMETERS, aerodynamics=dataclasses.replace(PARAMETERS.aerodynamics, drag_area=0.0)
    )
    held = _model(36_000.0, "roll", "traction", parameters=parameters).traction
    resistance = parameters.tires["trailer"].rolling_resistance
    data, bodies = _bodies(36_000.0, 0.0, parameters)
    last = FIRST_AXLE + 5
    load = static_axle_loads(parameters, 36_000.0)[-1]
    aside = resistance * load * bodies.wheels[-1, last]
    expected = -resistance * data.tires[-1] + aside
    assert held.angle[2, last] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_impossible_coupling_is_refused(value):
    with pytest.raises(InputError, match="roll_coupling"):
        YawRoll.from_parameters(PARAMETERS, 0.0, roll_coupling=value)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_impossible_speed_is_refused(speed):
    with pytest.raises(InputError, match="speed"):
        YawRoll.from_parameters(PARAMETERS, 0.0).at(speed)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_geometry_is_that_of_the_simulated_truck(payload):
    truck = Truck.load(payload, visuals=False)
    _, bodies = _bodies(payload, 0.0)
    data, origin = truck.data, truck.data.xpos[truck.model.body("tractor").id].copy()
    origin[0] -= PARAMETERS.lead.cg_position
    hitch = data.body("trailer").xpos - origin
    for i, unit in enumerate(("tractor", "trailer")):
        place = data.body(f"{unit}_pressure_center").xpos - origin
        row = bodies.pressure_centers[i]
        along = row[1] if unit == "tractor" else hitch[0] + row[2]
        up = -row[PHI_C] if unit == "tractor" else hitch[2] - row[PHI_T]
        np.testing.assert_allclose([along, up], place[[0, 2]], atol=1e-3)
    for i, axle in enumerate(PARAMETERS.axles):
        place = data.joint(f"{axle.name}_roll").xanchor - origin
        row, on_trailer = bodies.patches[i], i >= len(PARAMETERS.lead.axles)
        along = hitch[0] + row[2] if on_trailer else row[1]
        assert along == pytest.approx(place[0], abs=1e-3)
        assert row[FIRST_AXLE + i] == pytest.approx(place[2], abs=1e-3)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_tractor_lifts_its_nose_as_the_simulated_truck_does(payload):
    truck = Truck.load(payload, visuals=False)
    truck.reset(speed=V80)
    run_straight(truck, V80)
    change = cruise_axle_loads(PARAMETERS, payload, V80) - static_axle_loads(PARAMETERS, payload)
    pitch = lead_pitch(PARAMETERS, payload, change)
    assert pitch < 0.0
    assert pitch == pytest.approx(truck.observe().pitch, rel=0.05)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_yaw_roll_model_explains_the_step_steer_of_the_simulated_truck(payload):
    (recording,) = step_steers(free_couplings(PARAMETERS), payload, (np.deg2rad(3.0),), 0.002)
    speed = float(recording.speed.mean())
    model = YawRoll.from_parameters(PARAMETERS, payload, cruise_speed=speed)
    answer = simulate(model.at(speed), recording.time, recording.road_wheel)
    signals = ("yaw_rate", "trailer_yaw_rate", "articulation", "y", "roll", "trailer_roll")
    for name in signals:
        simulated = getattr(recording, name)
        assert fit(simulated - simulated[0], getattr(answer, name)) >= 99.5, name
