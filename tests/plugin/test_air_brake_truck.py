"""The complete truck: stopping distances of the standards, ABS, brake work, load sensing."""

import dataclasses

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.core.assets import mjcf_dir
from iits_mj.core.messages import XbrEbiMode, XbrMode
from iits_mj.core.units import KMH
from iits_mj.model.air_brake import circuit_loads, distribution
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.recorder import wheel_slips

PARAMETERS = TruckParameters.load()
BRAKE = PARAMETERS.air_brake
EMPTY, LADEN = 0.0, 36_000.0
MPH = 1609.344 / 3600


@dataclasses.dataclass(frozen=True)
class Stop:
    """A stop: distance [m] scaled to the nominal speed, longest wheel lock above 15 km/h [s]."""

    distance: float
    locked: float
    slowest_wheel: float


def stop(payload, speed, timestep=0.002, friction=0.8, **controls):
    route = Route.straight(2000.0).with_friction(friction, friction)
    truck = iits_mj.Truck.load(payload=payload, route=route, timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    truck.step(round(0.3 / timestep))
    start, actual = truck.observe().x, truck.observe().speed
    truck.command(**controls)
    slips, moving = [], []
    while (state := truck.observe()).speed > 0.05:
        assert truck.time < 15.0
        slips.append(wheel_slips(truck))
        moving.append(state.speed > 15 * KMH)
        truck.step(round(0.02 / timestep))
    slips = np.array(slips)[np.array(moving)]
    locked = 0.0
    for wheel in (slips > 0.8).T:
        run = 0.0
        for now in wheel:
            run = run + 0.02 if now else 0.0
            locked = max(locked, run)
    return Stop((state.x - start) * (speed / actual) ** 2, locked, slips.max())


@pytest.mark.parametrize("payload", [EMPTY, LADEN])
@pytest.mark.parametrize(
    "controls", [{"xbr_demand": -10.0, "xbr_mode": 2}, {"brake_pedal": 1.0}], ids=["xbr", "pedal"]
)
def test_stop_from_60_km_h_is_within_un_r13(payload, controls):
    """Type 0, laden and empty: 0.15 v + v^2 / 130."""
    result = stop(payload, 60 * KMH, **controls)
    assert 15.0 < result.distance < 0.15 * 60 + 60**2 / 130
    assert result.locked < 1.0


@pytest.mark.parametrize(("payload", "feet"), [(LADEN, 250.0), (EMPTY, 235.0)])
def test_stop_from_60_mph_is_within_fmvss_121(payload, feet):
    result = stop(payload, 60 * MPH, brake_pedal=1.0)
    assert 40.0 < result.distance < feet * 0.3048
    assert result.locked < 1.0


def test_empty_truck_keeps_its_wheels_turning_on_ice():
    """A chamber below its push-out pressure still brakes by its hysteresis: ABS empties it, too."""
    result = stop(EMPTY, 35 * KMH, friction=0.1, brake_pedal=1.0)
    assert result.locked < 0.3
    assert result.slowest_wheel < 0.6


@pytest.mark.parametrize("friction", [0.8, 0.3])
@pytest.mark.parametrize("payload", [EMPTY, LADEN])
def test_stop_does_not_depend_on_the_time_step(payload, friction):
    distances = [
        stop(payload, 60 * KMH, h, friction, brake_pedal=1.0).distance for h in (0.001, 0.005)
    ]
    assert distances[1] == pytest.approx(distances[0], rel=0.005)


def test_integration_mode_brakes_smoothly_through_gear_changes():
    truck = iits_mj.Truck.load(payload=LADEN, visuals=False)
    truck.reset(speed=80 * KMH)
    truck.step(500)
    truck.command(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM, xbr_ebi_mode=XbrEbiMode.INTEGRATION)
    truck.step(750)
    speeds, shifting = [], []
    while truck.observe().speed > 20 * KMH:
        truck.step(10)
        speeds.append(truck.observe().speed)
        shifting.append(truck.read("shift_in_process"))
    speeds = np.array(speeds)
    smooth = np.convolve(-np.gradient(speeds, 0.02), np.ones(10) / 10, mode="valid")
    assert sum(np.diff(shifting) > 0) >= 2
    assert smooth.mean() == pytest.approx(1.0, rel=0.03)
    assert np.all(np.abs(smooth - 1.0) < 0.3)
    assert np.abs(np.gradient(smooth, 0.02)).max() < 2.5  # jerk [m/s3], as in comfortable braking
    # Friction alone would take all of the kinetic energy.
    energy = 0.5 * PARAMETERS.gross_mass(LADEN) * (speeds[0] ** 2 - speeds[-1] ** 2)
    assert truck.read("brake_work") < 0.65 * energy


def test_brake_work_is_the_integral_of_brake_torque_times_wheel_speed():
    truck = iits_mj.Truck.load(payload=LADEN, visuals=False)
    truck.reset(speed=60 * KMH)
    truck.command(brake_pedal=0.3)
    model, data = truck.model, truck.data
    dofs = [
        model.joint(f"{axle.name}_{side}_spin").dofadr[0]
        for axle in PARAMETERS.axles
        for side in ("left", "right")
    ]
    work = 0.0
    for _ in range(1000):
        before = data.qvel[dofs].copy()
        mujoco.mj_step(model, data)
        torque = data.sensor("brake_torques").data
        work += model.opt.timestep * float(torque @ (0.5 * (before + data.qvel[dofs])))
    mujoco.mj_forward(model, data)
    assert work > 1e6
    assert data.sensor("brake_work").data[0] == pytest.approx(work, rel=1e-9)


@pytest.mark.parametrize("payload", [EMPTY, LADEN])
def test_all_axles_use_the_same_share_of_friction(payload):
    """Load sensing equalizes brake force over wheel load, here at 4 m/s2."""
    truck = iits_mj.Truck.load(payload=payload, visuals=False)
    truck.reset(speed=80 * KMH)
    truck.command(brake_pedal=4.0 / BRAKE.pedal_deceleration)
    truck.step(1000)
    used = []
    for axle in PARAMETERS.axles:
        forces = [truck.sensor(f"{axle.name}_{side}_tire_force") for side in ("left", "right")]
        used.append(-sum(f[0] for f in forces) / sum(f[2] for f in forces))
    assert np.mean(used) == pytest.approx(4.0 / 9.81, rel=0.05)
    assert np.ptp(used) < 0.2 * np.mean(used)


def test_axle_group_loads_carry_the_truck_and_shift_forward_in_braking():
    for payload in (EMPTY, LADEN):
        still, braked = (circuit_loads(PARAMETERS, payload, a) for a in (0.0, 5.0))
        weight = PARAMETERS.gross_mass(payload) * 9.80665
        assert still.sum() == pytest.approx(weight, rel=1e-3)
        assert braked.sum() == pytest.approx(weight, rel=1e-3)
        assert braked[0] > still[0]
        assert braked[2] < still[2]


def test_brakes_of_the_public_release_load_as_an_overlay_and_respond_late():
    overlay = mjcf_dir() / "overlays" / "release_brakes.toml"
    assert distribution(TruckParameters.load(overlay=overlay)).mass_heavy == 50_000.0
    truck = iits_mj.Truck.load(payload=LADEN, parameters=overlay, visuals=False)
    truck.reset(speed=60 * KMH)
    truck.step(100)
    truck.command(xbr_demand=-3.0, xbr_mode=2)
    pressures = []
    for _ in range(250):
        truck.step(5)
        pressures.append(truck.read("brake_pressure_rear_left"))
    reached = 0.01 * np.argmax(np.array(pressures) > 0.75 * pressures[-1])
    assert 0.7 < reached < 1.5
    assert pressures[-1] > 100e3


def test_unknown_distribution_is_refused_with_the_known_names():
    with pytest.raises(iits_mj.Error, match=r"distribution.*axle_loads.*table"):
        iits_mj.Truck.load(parameters={"air_brake": {"distribution": "even"}})
