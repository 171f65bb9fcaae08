"""Auxiliaries on the crankshaft, and the map of the fuel rate."""

import mujoco
import numpy as np
import pytest

from tests.plugin.laws_direct import law
from tests.plugin.test_gear_losses import of_powertrain, refusal
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

ENGINE, GEARBOX = PARAMETERS.engine, PARAMETERS.gearbox
POWER = 15e3
AUXILIARIES = {("powertrain", "auxiliary_power"): f"{POWER}"}
WORK = [("auxiliary_work", "powertrain")]


def rate(torque, speed):
    """Fuel rate [kg/s] that a map of a few points has exactly, down to overrun."""
    return 1e-6 * speed * (10 + 0.05 * torque)


TORQUES, SPEEDS = (-200.0, 1000.0, 3000.0), (50.0, 150.0, 250.0)
RATE = {
    "fuel_map_torque": "",
    "fuel_map_speed": "",
    "fuel_map_consumption": "",
    "idle_fuel_rate": "",
    "fuel_rate_torque": " ".join(map(str, TORQUES)),
    "fuel_rate_speed": " ".join(map(str, SPEEDS)),
    "fuel_rate_values": " ".join(f"{rate(t, w):.9g}" for t in TORQUES for w in SPEEDS),
}


def test_idle_governor_carries_the_auxiliaries():
    sled = Sled(15_000.0, changes=AUXILIARIES).run(3.0)
    assert sled["engine_speed"] == pytest.approx(ENGINE.idle_speed, rel=1e-3)
    assert sled["engine_torque"] == pytest.approx(POWER / ENGINE.idle_speed, rel=1e-2)
    # It burns the fuel of this torque; at idle the engine gives no other power.
    assert sled["fuel_rate"] > 1.5 * Sled(15_000.0).run(3.0)["fuel_rate"]


@pytest.mark.parametrize("kmh", [0, 70])
def test_auxiliaries_take_their_power_times_the_time(kmh):
    sled = Sled(1e8, speed=kmh * KMH, rolling=False, changes=AUXILIARIES, sensors=WORK)
    sled.run(3.0)
    before = sled["auxiliary_work"]
    sled.run(5.0)
    assert sled["auxiliary_work"] - before == pytest.approx(5.0 * POWER, rel=1e-3)


def test_pulling_engine_gives_the_clutch_its_torque_less_the_auxiliaries():
    def ends(changes):
        sled = Sled(1e8, speed=80 * KMH, rolling=False, changes=changes)
        return sled.run(10.0, accelerator_pedal=0.6)

    with_power, without = ends(AUXILIARIES), ends({})
    assert with_power["gear"] == without["gear"] == len(GEARBOX.ratios)
    assert with_power["engine_torque"] == pytest.approx(without["engine_torque"], rel=1e-3)
    taken = without["propeller_shaft_torque"] - with_power["propeller_shaft_torque"]
    share = GEARBOX.efficiency * GEARBOX.driveline_efficiency
    assert taken == pytest.approx(share * POWER / with_power["engine_speed"], rel=0.02)


def test_auxiliaries_brake_in_overrun_without_fuel():
    sleds = [Sled(1e8, speed=80 * KMH, rolling=False, changes=c) for c in (AUXILIARIES, {})]
    for sled in sleds:
        sled.run(4.0)
        assert sled["fuel_rate"] == 0
    torques = [sled["propeller_shaft_torque"] for sled in sleds]
    share = GEARBOX.efficiency * GEARBOX.driveline_efficiency
    taken = POWER / sleds[0]["engine_speed"] / share
    assert torques[1] - torques[0] == pytest.approx(taken, rel=0.02)


def test_percent_torques_are_those_of_the_engine_with_its_auxiliaries():
    # SPN 513 counts the whole combustion, SPN 514 the engine's own friction.
    sled = Sled(15_000.0, changes=AUXILIARIES).run(3.0)
    drag = np.interp(sled["engine_speed"], ENGINE.drag_speed, ENGINE.drag_torque)
    of_reference = 100 / ENGINE.reference_torque
    assert sled["torque_loss_percent"] == pytest.approx(of_reference * drag, rel=1e-3)
    indicated = drag + sled["engine_torque"]
    assert sled["engine_torque_percent"] == pytest.approx(of_reference * indicated, rel=1e-3)


@pytest.mark.parametrize("mass", [15_000.0, 40_000.0])
def test_truck_starts_on_a_grade_with_great_auxiliaries(mass):
    changes = {("powertrain", "auxiliary_power"): "25e3"}
    sled = Sled(mass, grade=0.03, changes=changes)
    rows = sled.record(12.0, "engine_speed", "speed", accelerator_pedal=0.8)
    assert rows[:, 0].min() > 0.8 * ENGINE.idle_speed
    assert rows[-1, 1] > 2.0


def test_auxiliaries_release_a_stalled_engine():
    def torque(speed):
        point = np.zeros(5)
        law("engine_with_auxiliaries_at", POWER, speed, point)
        return point[4]

    idle = 62.8
    assert torque(200.0) == pytest.approx(POWER / 200)
    assert torque(0.5 * idle) == pytest.approx(POWER / (0.5 * idle))
    assert torque(0.25 * idle) == pytest.approx(0.5 * POWER / (0.5 * idle))
    assert torque(0.0) == 0


@pytest.mark.parametrize("factor", [1.0, 1.02])
@pytest.mark.parametrize("pedal", [0.15, 0.5, 0.9])
def test_fuel_rate_is_the_maps_at_the_engines_torque(pedal, factor):
    changes = of_powertrain(RATE | {"fuel_factor": f"{factor}"})
    sled = Sled(1e8, speed=70 * KMH, rolling=False, changes=changes)
    sled.run(6.0, accelerator_pedal=pedal)
    expected = factor * rate(sled["engine_torque"], sled["engine_speed"])
    assert sled["fuel_rate"] == pytest.approx(expected, rel=1e-3)


def test_fuel_rate_holds_between_no_load_and_overrun():
    """Below the lowest torque of a map the rate falls to zero where the combustion ends."""
    drag = 100.0
    for torque, expected in ((-50.0, 5.0), (-75.0, 2.5), (0.0, 5.625), (200.0, 8.125)):
        found = law("engine_fuel_by_rate", torque + drag, drag)
        assert found == pytest.approx(1e-3 * expected), torque
    assert law("engine_fuel_by_rate", 0.0, drag) == 0


def test_fuel_factor_scales_the_consumption_map_too():
    rates = []
    for factor in ("1", "0.97"):
        changes = {("powertrain", "fuel_factor"): factor}
        sled = Sled(1e8, speed=70 * KMH, rolling=False, changes=changes)
        rates.append(sled.run(4.0, accelerator_pedal=0.5)["fuel_rate"])
    assert rates[1] == pytest.approx(0.97 * rates[0], rel=1e-9)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"fuel_rate_torque": "0 1"}, "'fuel_rate_speed' is missing"),
        (RATE | {"fuel_rate_torque": ""}, "'fuel_rate_speed' needs 'fuel_rate_torque'"),
        (
            {k: v for k, v in RATE.items() if k.startswith("fuel_rate")},
            "needs either fuel_map_torque or fuel_rate_torque",
        ),
        ({"idle_fuel_rate": ""}, "'idle_fuel_rate' is missing"),
        ({"auxiliary_power": "-1"}, "'auxiliary_power' has '-1'"),
        (
            {"shift_strategy": "tables", "upshift_gear": "", "upshift_pedal": ""}
            | {"upshift_speed": ""},
            "shift_strategy 'tables' needs upshift_gear and downshift_gear",
        ),
    ],
)
def test_wrong_combination_of_attributes_is_refused(attributes, message):
    assert message in refusal(attributes)


def test_work_and_fuel_are_not_booked_twice_by_forward():
    sled = Sled(2e4, speed=10.0, changes=AUXILIARIES, sensors=WORK)
    sled.run(1.0, accelerator_pedal=0.5)
    mujoco.mj_forward(sled.model, sled.data)
    before = sled["auxiliary_work"], sled["fuel_used"]
    mujoco.mj_forward(sled.model, sled.data)
    assert (sled["auxiliary_work"], sled["fuel_used"]) == before
