"""Energy balance and fuel of the powertrain."""

import mujoco
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from tests.plugin.test_gear_losses import ALL, of_powertrain
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

ENGINE, GEARBOX = PARAMETERS.engine, PARAMETERS.gearbox
SUMS = ("engine_work", "driveline_loss", "retarder_work", "driveline_energy")
AUXILIARY = "auxiliary_work"
# Every loss that a truck may have.
LOSSES = ALL | of_powertrain({"shift_strategy": "adaptive", "auxiliary_power": "8e3"})
CHANGES = pytest.mark.parametrize("changes", [{}, LOSSES], ids=["shares", "maps"])


def shaft_shares(model):
    """Returns the coefficient of each joint speed [nv] in the speed of the propeller shaft."""
    shares = np.zeros(model.nv)
    tendon = model.tendon("propeller_shaft")
    first = model.tendon_adr[tendon.id]
    for i in range(first, first + model.tendon_num[tendon.id]):
        shares[model.jnt_dofadr[model.wrap_objid[i]]] = model.wrap_prm[i]
    return shares


class Audit:
    """Drives a sled step by step and integrates the work of its propeller shaft."""

    def __init__(self, mass, **options):
        self.sled = sled = Sled(mass, sensors=[(AUXILIARY, "powertrain")], **options)
        self.shares = shaft_shares(sled.model)
        self.shaft_work = 0.0
        mujoco.mj_forward(sled.model, sled.data)
        self.start = self.sums()

    def sums(self):
        return np.array([self.sled[name] for name in (*SUMS, AUXILIARY)])

    def run(self, seconds, **controls):
        sled, h = self.sled, self.sled.model.opt.timestep
        sled.command(**controls)
        losses = []
        for _ in range(round(seconds / h)):
            before = self.shares @ sled.data.qvel
            mujoco.mj_step(sled.model, sled.data)
            after = self.shares @ sled.data.qvel
            self.shaft_work += h * sled["propeller_shaft_torque"] * (before + after) / 2
            losses.append(sled["driveline_loss"])
        return np.array(losses)

    def balance(self):
        """Returns the engine's work and the error of the energy balance [J].

        All that the engine gives goes to the auxiliaries and the shaft, is lost, or stays.
        """
        mujoco.mj_forward(self.sled.model, self.sled.data)
        engine, *others = self.sums() - self.start
        return engine, engine - sum(others) - self.shaft_work


def hilly_drive(timestep, changes):
    audit = Audit(40_000.0, timestep=timestep, changes=changes)
    audit.run(40.0, accelerator_pedal=0.8)
    audit.run(5.0, accelerator_pedal=0.0)
    audit.run(5.0, engine_brake=1.0, retarder=0.5)
    audit.run(5.0, engine_brake=0.0, retarder=0.0, accelerator_pedal=0.5)
    audit.run(3.0, transmission_mode=1, accelerator_pedal=0.3)
    audit.run(8.0, transmission_mode=0, accelerator_pedal=0.0, xbr_demand=-2.0, xbr_mode=2)
    return audit


@CHANGES
@pytest.mark.parametrize("timestep", [0.001, 0.002, 0.005])
def test_engine_work_equals_shaft_work_losses_and_stored_energy(timestep, changes):
    audit = hilly_drive(timestep, changes)
    work, missing = audit.balance()
    assert work > 1e6
    assert abs(missing) < 1e-9 * work


@CHANGES
@pytest.mark.parametrize("seed", range(3))
def test_energy_balance_holds_under_any_commands(seed, changes):
    random = np.random.default_rng(seed)
    audit = Audit(30_000.0, speed=8.0 - 4.0 * seed, timestep=0.005, changes=changes)
    for _ in range(60):
        braking = random.random() < 0.4
        audit.run(
            1.0,
            accelerator_pedal=0.0 if braking else random.random(),
            engine_brake=random.random() if braking else 0.0,
            retarder=random.random() if braking else 0.0,
            xbr_demand=-2.0 * random.random() if braking else 0.0,
            xbr_mode=2,
            transmission_mode=random.choice([0, 1, 2], p=[0.8, 0.1, 0.1]),
        )
    sled = audit.sled
    assert np.isfinite(sled.data.plugin_state).all()
    assert sled.data.warning.number.sum() == 0
    turned = np.abs([audit.shaft_work, *audit.sums()]).sum()
    assert turned > 1e5
    assert abs(audit.balance()[1]) < 1e-9 * turned


def test_driveline_loss_equals_the_gear_losses_while_the_clutch_is_closed():
    audit = Audit(10_000_000.0, speed=60 * KMH)
    audit.run(4.0, accelerator_pedal=0.6)
    start, shaft = audit.sums(), audit.shaft_work
    audit.run(4.0)
    lost = (audit.sums() - start)[1] / (audit.shaft_work - shaft)
    assert lost == pytest.approx(1 / (GEARBOX.efficiency * GEARBOX.driveline_efficiency) - 1, 0.01)


@pytest.mark.parametrize("controls", [{"accelerator_pedal": 0.7}, {"engine_brake": 1.0}])
def test_driveline_loss_never_decreases_in_a_gear(controls):
    losses = Audit(10_000_000.0, speed=50 * KMH).run(4.0, **controls)
    assert losses[-1] > 1e4
    assert np.diff(losses).min() > -1e-6


def test_launch_loses_about_the_kinetic_energy_in_the_clutch():
    # A clutch that slips at constant torque and engine speed loses as much as it transmits; it
    # loses less if the engine slows down.
    sled = Sled(55_000.0, rolling=False, sensors=[("clutch_loss", "powertrain")])
    sled.record(0.01, "speed", accelerator_pedal=0.4)
    while sled["clutch_engagement"] < 1:
        sled.run(0.01)
    kinetic = 0.5 * sled["propeller_shaft_speed"] ** 2 * shaft_inertia(sled.model)
    assert 0.6 * kinetic < sled["clutch_loss"] < 1.6 * kinetic


def shaft_inertia(model):
    """Returns the sled's inertia about the propeller shaft [kg m2], wheels included."""
    radius = PARAMETERS.tires["drive"].rolling_radius / GEARBOX.final_drive
    wheels = sum(
        2 * axle.wheel_inertia_spin / PARAMETERS.tires[axle.tire].rolling_radius ** 2
        for axle in PARAMETERS.axles
    )
    return (model.body_subtreemass[0] + wheels) * radius**2


def pedal_for(torque, speed):
    """Returns the pedal at which the map has this torque at this engine speed."""
    table = ENGINE.pedal_map
    torques = [np.interp(speed, table.rows, column) for column in table.values.T]
    return float(np.interp(torque, torques, table.columns))


@pytest.mark.parametrize("offset", [0.0, 0.5], ids=["at_grid_points", "between_them"])
@pytest.mark.parametrize("column", [5, 7, 9])
@pytest.mark.parametrize("row", [1, 3, 6])
def test_fuel_at_a_steady_point_equals_the_consumption_map_within_a_percent(row, column, offset):
    table = ENGINE.fuel_map
    torque = (1 - offset) * table.rows[row] + offset * table.rows[row + 1]
    speed = (1 - offset) * table.columns[column] + offset * table.columns[column + 1]
    # In top gear, on a sled so heavy that it holds the engine's speed.
    vehicle = speed * PARAMETERS.tires["drive"].rolling_radius / GEARBOX.final_drive
    sled = Sled(10_000_000.0, speed=vehicle, rolling=False, timestep=0.005)
    sled.run(8.0, accelerator_pedal=pedal_for(torque, speed))
    assert sled["gear"] == len(GEARBOX.ratios)
    at = sled["engine_torque"], sled["engine_speed"]
    assert at == pytest.approx((torque, speed), rel=0.02)
    consumption = RegularGridInterpolator((table.rows, table.columns), table.values)
    assert sled["fuel_rate"] == pytest.approx(consumption(at).item() * at[0] * at[1], rel=1e-3)
    assert sled["fuel_rate"] / (at[0] * at[1]) == pytest.approx(
        consumption((torque, speed)).item(), rel=0.01
    )
