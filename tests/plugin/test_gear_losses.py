"""Maps of torque losses, drag of the empty retarder, and efficiencies by gear."""

import mujoco
import numpy as np
import pytest

from tests.plugin.laws_direct import law
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled, sled_xml

GEARBOX = PARAMETERS.gearbox
GEARS = len(GEARBOX.ratios)
RADIUS = PARAMETERS.tires["drive"].rolling_radius


def gear_loss(speed, torque):
    """Loss of a gear [N m], which a map of a few points has exactly."""
    return 3 + 0.02 * speed + 0.02 * abs(torque)


def direct_loss(speed, torque):
    """Loss of the direct gear [N m]."""
    return 1 + 0.01 * speed + 0.005 * abs(torque)


def axle_loss(speed, torque):
    """Loss of the final drive [N m]."""
    return 15 + 0.1 * speed + 0.03 * abs(torque)


def numbers(values):
    return " ".join(f"{value:.12g}" for value in np.ravel(values))


def blocks(speeds, torques, *losses):
    return numbers([[[loss(w, t) for t in torques] for w in speeds] for loss in losses])


SPEEDS, TORQUES = (0.0, 100.0, 200.0), (-500.0, 0.0, 1000.0)
AXLE_SPEEDS, AXLE_TORQUES = (0.0, 300.0), (-3000.0, 0.0, 8000.0)
GEAR_MAPS = {
    "gear_loss_speed": numbers(SPEEDS),
    "gear_loss_torque": numbers(TORQUES),
    "gear_losses": blocks(SPEEDS, TORQUES, gear_loss, direct_loss),
    # All but the lowest, which have an efficiency.
    "gear_loss_map": numbers([0] * 6 + [1] * (GEARS - 7) + [2]),
}
AXLE_MAP = {
    "axle_loss_speed": numbers(AXLE_SPEEDS),
    "axle_loss_torque": numbers(AXLE_TORQUES),
    "axle_losses": blocks(AXLE_SPEEDS, AXLE_TORQUES, axle_loss),
}
DRAG = {"retarder_drag_speed": "0 100 300", "retarder_drag_torque": "10 20 90"}
ALL = {("powertrain", k): v for k, v in (GEAR_MAPS | AXLE_MAP | DRAG).items()}


def of_powertrain(attributes):
    return {("powertrain", k): v for k, v in attributes.items()}


def held(kmh, controls, attributes, seconds=4.0):
    """Returns a sled so heavy that it holds its speed, after a while with constant controls."""
    changes = of_powertrain({"shift_strategy": "adaptive"} | attributes)
    return Sled(1e8, speed=kmh * KMH, rolling=False, changes=changes).run(seconds, **controls)


def shaft_torque(sled, losses):
    """Returns the torque of the steady engine at the shaft by the `losses` of gear and axle."""
    ratio = GEARBOX.ratios[int(sled["gear"]) - 1]
    shaft = sled["propeller_shaft_speed"]
    torque = sled["engine_torque"]
    torque = (torque - losses[0](ratio * shaft, torque)) * ratio
    return torque - losses[1](shaft, torque)


@pytest.mark.parametrize("pedal", [0.0, 0.9])
@pytest.mark.parametrize(("kmh", "loss"), [(50, gear_loss), (85, direct_loss)])
def test_maps_take_their_torque_at_the_input_of_gear_and_axle(kmh, loss, pedal):
    # The pulling engine's torque lies beyond the map, which continues as a straight line.
    sled = held(kmh, {"accelerator_pedal": pedal}, GEAR_MAPS | AXLE_MAP)
    assert sled["clutch_engagement"] == 1
    assert (sled["engine_torque"] > 1000) == (pedal > 0)
    expected = shaft_torque(sled, (loss, axle_loss))
    assert sled["propeller_shaft_torque"] == pytest.approx(expected, rel=2e-3)


def test_gear_without_a_map_keeps_its_efficiency():
    sled = held(12, {"accelerator_pedal": 0.6}, GEAR_MAPS)
    assert sled["gear"] <= 6
    losses = (
        (lambda _, t: (1 - GEARBOX.efficiency) * t),
        (lambda _, t: (1 - GEARBOX.driveline_efficiency) * t),
    )
    assert sled["propeller_shaft_torque"] == pytest.approx(shaft_torque(sled, losses), rel=2e-3)


@pytest.mark.parametrize("kmh", [50, 85])
def test_every_gear_may_have_its_own_efficiency(kmh):
    shares = np.linspace(0.9, 0.99, GEARS)
    sled = held(kmh, {"accelerator_pedal": 0.6}, {"efficiency": numbers(shares)})
    share = shares[int(sled["gear"]) - 1]
    losses = (lambda _, t: (1 - share) * t), (lambda _, t: (1 - GEARBOX.driveline_efficiency) * t)
    assert sled["propeller_shaft_torque"] == pytest.approx(shaft_torque(sled, losses), rel=2e-3)


@pytest.mark.parametrize(("speed", "drag"), [(50.0, 15.0), (150.0, 37.5), (400.0, 90.0)])
def test_empty_retarder_drags_the_shaft_of_a_truck_in_neutral(speed, drag):
    changes = of_powertrain(DRAG | {"retarder_torque_max": "0", "driveline_efficiency": "1"})
    start = speed * RADIUS / GEARBOX.final_drive
    for sign in (1, -1):
        sled = Sled(1e8, speed=sign * start, rolling=False, changes=changes)
        sled.run(1.0, transmission_mode=1)
        assert sled["propeller_shaft_torque"] == pytest.approx(-sign * drag, rel=1e-3)


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_losses_never_move_a_truck_at_rest(mode):
    sled = Sled(15_000.0, rolling=False, changes=ALL)
    sled.run(5.0, transmission_mode=mode)
    assert sled["speed"] == 0
    assert sled["propeller_shaft_torque"] == 0


@pytest.mark.parametrize("speed", [-1.0, 3.0])
def test_losses_stop_a_rolling_truck_and_do_not_reverse_it(speed):
    sled = Sled(8_000.0, speed=speed, rolling=False, changes=ALL).run(1.0, transmission_mode=1)
    rows = sled.record(30.0, "speed", "driveline_loss")
    assert (speed * rows[:, 0] >= 0).all()
    assert (np.diff(np.abs(rows[:, 0])) <= 1e-12).all()
    assert (np.diff(rows[:, 1]) >= -1e-9).all()
    assert abs(rows[-1, 0]) < 0.9 * abs(speed)


def test_losses_never_give_energy():
    sled = Sled(20_000.0, changes=ALL, sensors=[("clutch_loss", "powertrain")])
    for seconds, controls in (
        (15, {"accelerator_pedal": 0.6}),
        (4, {"accelerator_pedal": 0.0, "engine_brake": 1.0}),
        (3, {"engine_brake": 0.0, "retarder": 1.0}),
        (6, {"retarder": 0.0, "xbr_demand": -3.0, "xbr_mode": 2}),
        (6, {"xbr_demand": 0.0, "transmission_mode": 2, "accelerator_pedal": 0.3}),
    ):
        rows = sled.record(seconds, "driveline_loss", "clutch_loss", **controls)
        of_gears = rows[:, 0] - rows[:, 1]
        assert np.diff(of_gears).min() > -1e-6
        assert of_gears[-1] > of_gears[0] + 100


@pytest.mark.parametrize("attributes", [{}, GEAR_MAPS | AXLE_MAP | DRAG], ids=["shares", "maps"])
def test_brakes_get_the_shaft_torque_that_they_demand(attributes):
    """Engine brake and retarder give the demand less what the losses brake."""
    changes = of_powertrain({"shift_strategy": "adaptive"} | attributes)
    mass = 40_000.0
    sled = Sled(mass, speed=80 * KMH, rolling=False, changes=changes)
    sled.run(2.5, xbr_demand=-0.4, xbr_mode=2, xbr_ebi_mode=1)
    rows = sled.record(2.0, "propeller_shaft_torque", "endurance_torque_demand")
    assert sled["shift_in_process"] == 0
    assert rows[:, 0].mean() == pytest.approx(-rows[:, 1].mean(), rel=0.02)
    assert rows[:, 1].mean() > 1000


@pytest.mark.parametrize("torque", [-800.0, 0.0, 20.0, 900.0, 15_000.0])
@pytest.mark.parametrize("gear", [1, 3, 5])
def test_prediction_of_the_input_torque_inverts_that_of_the_shaft_torque(gear, torque):
    for maps in (0, 1):
        given = law("gears_input_torque", maps, gear, torque, 120.0)
        assert law("gears_shaft_torque", maps, gear, given, 120.0) == pytest.approx(
            torque, rel=1e-5, abs=0.02
        )
        assert not maps or given > torque / (11.67, 6, 3.2, 1.8, 1)[gear - 1]


def refusal(attributes):
    changes = of_powertrain(attributes)
    with pytest.raises(ValueError, match="plugin instance") as error:
        mujoco.MjModel.from_xml_string(sled_xml(2e4, changes=changes))
    return str(error.value)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"efficiency": "0.98 0.97"}, f"'efficiency' has 2 numbers; allowed are 1 or {GEARS}"),
        (GEAR_MAPS | {"gear_losses": "1 2 3"}, "'gear_losses' has 3 numbers; allowed are 9 to"),
        (GEAR_MAPS | {"gear_losses": "1 " * 10}, "'gear_losses' has 10 numbers; allowed are multi"),
        (GEAR_MAPS | {"gear_loss_map": "3 " * GEARS}, "gear_loss_map 3 must not exceed the num"),
        ({"gear_loss_speed": "0 1"}, "'gear_loss_torque' is missing"),
        ({"axle_losses": "0 1"}, "'axle_losses' needs 'axle_loss_speed', which is missing"),
        (AXLE_MAP | {"axle_losses": "-1 " * 6}, "'axle_losses' has '-1"),
        ({"retarder_drag_torque": "0 1"}, "'retarder_drag_torque' needs 'retarder_drag_speed'"),
    ],
)
def test_wrong_map_is_refused_with_what_is_allowed(attributes, message):
    assert message in refusal(attributes)
