"""Parameters of engine, retarder, clutch and gearbox: a truck's TOML and its CSV tables.

The TOML gives meaning, unit and source of each number; all are in SI units.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.parameters.quantity import (
    Acceleration,
    Count,
    Efficiency,
    Inertia,
    KilogramsPerSecond,
    NewtonMeters,
    NewtonMetersPerSecond,
    Pure,
    RadiansPerSecond,
    Ratio,
    RollDamping,
    RollStiffness,
    Seconds,
    Speed,
    Watts,
)
from iits_mj.parameters.tables import NO_TABLE, Table2D

_LOSS_STEPS = 6  # of the inverse of a map of losses; each reduces the error fifty times
SHIFT_STRATEGIES = ("tables", "adaptive")
# Figures of an engine in proportion to its displacement, and axes and values of its tables.
EXTENSIVE = (
    "full_load_torque",
    "drag_torque",
    "reference_torque",
    "inertia",
    "torque_rise_rate",
    "torque_rise_rate_low",
    "torque_rise_threshold",
    "torque_fall_rate",
    "torque_fall_rate_low",
    "torque_fall_threshold",
    "idle_gain",
    "idle_integral_gain",
    "idle_integral_min",
    "idle_integral_max",
    "engine_brake_power",
    "idle_fuel_rate",
)
EXTENSIVE_TABLES = {
    "pedal_map": ("values",),
    "fuel_map": ("rows",),
    "fuel_rate_map": ("columns", "values"),
}


@dataclass(frozen=True)
class Engine:
    """The engine. Its torque includes what the auxiliaries take.

    A file may give the rated `power` instead of figures of its own: the engine is then one of the
    same family as that of the file it extends, with all torques, inertia and fuel in proportion.

    Attributes:
      full_load_speed, full_load_torque: [rad/s], [N m], shape (n,).
      pedal_map: torque [N m] over engine speed [rad/s] (rows) and pedal 0..1 (columns); without
        one, the pedal demands its share of the rated power, within the full load.
      fuel_map: BSFC [kg/J] over torque [N m] (rows) and engine speed [rad/s] (columns), or
      fuel_rate_map: fuel rate [kg/s] over engine speed [rad/s] (rows) and torque [N m] (columns).
      fuel_factor: on the fuel of the map.
      auxiliaries: mean power of each, at the crankshaft.
    """

    idle_speed: RadiansPerSecond
    governed_speed: RadiansPerSecond
    governor_droop: Pure
    reference_torque: NewtonMeters
    inertia: Inertia
    pedal_up: Pure
    pedal_fade: Pure
    pedal_return_time: Seconds
    torque_rise_rate: NewtonMetersPerSecond
    torque_rise_rate_low: NewtonMetersPerSecond
    torque_rise_threshold: NewtonMeters
    torque_fall_rate: NewtonMetersPerSecond
    torque_fall_rate_low: NewtonMetersPerSecond
    torque_fall_threshold: NewtonMeters
    torque_cut_time: Seconds
    boost_lag: Seconds
    spool_time: Seconds
    idle_gain: RollDamping
    idle_integral_gain: RollStiffness
    idle_band: RadiansPerSecond
    idle_integral_min: NewtonMeters
    idle_integral_max: NewtonMeters
    idle_forget_time: Seconds
    synchronization_lag: Seconds
    synchronization_torque_share: Pure
    synchronization_brake_share: Pure
    drag_speed: tuple[RadiansPerSecond, ...]
    drag_torque: tuple[NewtonMeters, ...]
    engine_brake_power: Watts
    engine_brake_speed: RadiansPerSecond
    engine_brake_exponent: Pure
    engine_brake_speed_min: RadiansPerSecond
    engine_brake_fade: RadiansPerSecond
    engine_brake_lag: Seconds
    engine_brake_release_lag: Seconds
    idle_fuel_rate: KilogramsPerSecond
    full_load_speed: FloatArray
    full_load_torque: FloatArray
    pedal_map: Table2D = NO_TABLE
    fuel_map: Table2D = NO_TABLE
    fuel_rate_map: Table2D = NO_TABLE
    fuel_factor: Pure = 1.0
    auxiliaries: dict[str, Watts] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.full_load_speed.shape != self.full_load_torque.shape:
            raise InputError("engine.full_load: speed and torque have different lengths")
        if not (self.full_load_torque * self.full_load_speed > 0.0).any():
            raise InputError("engine.full_load: no torque and speed are above zero")
        if bool(self.fuel_map.values.size) is bool(self.fuel_rate_map.values.size):
            raise InputError("engine: exactly one of fuel_map and fuel_rate_map is needed")

    @property
    def auxiliary_power(self) -> float:
        """Mean power of all auxiliaries [W]."""
        return sum(self.auxiliaries.values())

    def auxiliary_torque(self, speed: ArrayLike) -> FloatArray:
        """Returns what the auxiliaries take [N m] at engine speeds [rad/s], same shape.

        Their power is constant above half of the idle speed; the torque is proportional below.
        """
        slowest, turns = 0.5 * self.idle_speed, np.asarray(speed, dtype=float)
        share = np.minimum(turns / slowest, 1.0)
        return np.asarray(self.auxiliary_power * share / np.maximum(turns, slowest))

    @property
    def half_torque(self) -> tuple[float, float]:
        """Speed of the greatest torque [rad/s], and half of this torque [N m]."""
        most = int(np.argmax(self.full_load_torque))
        return float(self.full_load_speed[most]), 0.5 * float(self.full_load_torque[most])

    def full_pedal_torque(self, speed: FloatArray) -> FloatArray:
        """Returns the torques [N m] at full pedal and engine speeds [rad/s], same shape.

        The pedal map may ask for less than the full load.
        """
        full = np.interp(speed, self.full_load_speed, self.full_load_torque)
        pedal = self.completed().pedal_map
        return np.asarray(np.minimum(full, np.interp(speed, pedal.rows, pedal.values[:, -1])))

    def lost_pull(self, pause: float) -> float:
        """Returns the time [s] of full pull that is lost by a pause of the combustion [s].

        It is longer than the pause, because the torque comes back only as fast as the charge
        pressure: the integral of the plugin's law, from and to the greatest torque.
        """
        torque = self.full_pedal_torque(self.full_load_speed)
        most = int(np.argmax(torque))
        drag = np.interp(self.full_load_speed[most], self.drag_speed, self.drag_torque)
        full = float(torque[most] + drag)
        left = max(full - pause * self.torque_fall_rate_low, min(self.torque_rise_threshold, full))
        gap, last = full - left, self.torque_rise_rate * self.spool_time
        deficit = self.boost_lag * gap + self.spool_time * max(gap - last, 0.0)
        deficit += 0.5 * min(gap, last) ** 2 / self.torque_rise_rate
        return pause + (deficit + 0.5 * left**2 / self.torque_rise_rate_low) / full

    @property
    def full_load_power(self) -> float:
        """Greatest power of the full-load curve [W]."""
        return float((self.full_load_torque * self.full_load_speed).max())

    def completed(self) -> Engine:
        """Returns the engine with a pedal map.

        Without one, the pedal demands a share of the rated power: at the same pedal a higher gear
        gives the same force, as in trucks with automated gearboxes.
        """
        if self.pedal_map.values.size:
            return self
        pedal = np.linspace(0.0, 1.0, 21)
        low, high = self.full_load_speed[[0, -1]]
        speed = np.unique([*self.full_load_speed, *np.linspace(low, high, 16)])
        full = np.interp(speed, self.full_load_speed, self.full_load_torque)
        demand = np.outer(self.full_load_power / speed, pedal)
        torque = np.minimum(demand, full[:, None])
        torque[:, -1] = full
        table = Table2D(speed, pedal, torque)
        return dataclasses.replace(self, pedal_map=table)


@dataclass(frozen=True)
class Retarder:
    """Hydrodynamic retarder on the propeller shaft; `torque_max` 0 is a truck without one.

    `drag_speed`, `drag_torque`: drag of the empty retarder.
    """

    torque_max: NewtonMeters
    full_torque_speed: RadiansPerSecond
    power_max: Watts
    power_continuous: Watts
    heat_time: Seconds
    derate_heat: Pure
    fill_time: Seconds
    empty_time: Seconds
    drag_speed: tuple[RadiansPerSecond, ...] = ()
    drag_torque: tuple[NewtonMeters, ...] = ()

    def empty_drag(self, shaft_speed: ArrayLike) -> FloatArray:
        """Returns the drag torques [N m] at speeds of the propeller shaft [rad/s], same shape."""
        if not self.drag_speed:
            return np.zeros_like(np.asarray(shaft_speed, dtype=float))
        turns = np.asarray(shaft_speed, dtype=float)
        return np.asarray(np.interp(turns, self.drag_speed, self.drag_torque))


@dataclass(frozen=True)
class Clutch:
    """Motion of the clutch; its capacity and engagement times are in `Gearbox`."""

    opening_time: Seconds
    launch_range: RadiansPerSecond
    alike_range: RadiansPerSecond
    release_share: Pure
    release_share_coast: Pure
    stall_share: Pure
    stall_range: Pure


@dataclass(frozen=True)
class Shifting:
    """Parameters of the gearbox controller in addition to the shift tables."""

    acceleration_lag: Seconds
    load_lag: Seconds
    pedal_lag: Seconds
    reversal_time: Seconds
    lowest_speed: Pure
    lowest_speed_pedal: Pure
    rolling_speed: Pure
    recovery_horizon: Seconds
    recovery_speed: Pure
    recovery_time: Seconds
    relaunch_speed: Pure
    upshift_speed_margin: Pure
    downshift_speed_margin: Pure
    downshift_speed_max: Pure
    power_speed: Pure
    overspeed: Pure
    overspeed_braking: Pure
    torque_reserve: Pure
    failed_reserve: Pure
    failed_load: Pure
    built_up_torque: Pure
    stuck_acceleration: Acceleration
    first_gear_delay: Seconds
    engage_speed_max: Speed
    floored_pedal: Pure
    kick_down_pedal: Pure
    kick_down_rise: Pure
    kick_down_speed: Pure
    skip_up_max: Count
    skip_down_max: Count
    braking_speed_low: Pure
    braking_speed_high: Pure
    braking_deceleration: Acceleration
    adaptive_period: Seconds
    adaptive_reserve: Pure
    adaptive_gain: Pure
    adaptive_speed_max: Pure
    adaptive_horizon: Seconds
    adaptive_time_price: KilogramsPerSecond
    adaptive_climb_speed: Pure


@dataclass(frozen=True)
class Loss:
    """Losses of a pair of gears: an efficiency, or a map of the torque loss if there is one.

    The plugin's `GearLoss` has the same rule: the map continues in straight lines beyond its edges,
    and no loss is below zero. Torques are negative in overrun, and without the ratio.

    Attributes:
      table: loss [N m] over speed [rad/s] and torque [N m] of the input.
    """

    efficiency: float
    table: Table2D = NO_TABLE

    def of(self, torque: FloatArray, speed: FloatArray) -> FloatArray:
        """Returns the losses of the map [N m] at torques and speeds of the input, same shape."""
        return np.maximum(self.table.extrapolated(speed, torque), 0.0)

    def after(self, torque: FloatArray, speed: FloatArray) -> FloatArray:
        """Returns the torques behind the gears for those before them, same shape."""
        if self.table.values.size:
            return torque - self.of(torque, speed)
        return torque * np.where(torque >= 0.0, self.efficiency, 1.0 / self.efficiency)

    def before(self, torque: FloatArray, speed: FloatArray) -> FloatArray:
        """Returns the torques before the gears for those behind them: the inverse of `after`."""
        if not self.table.values.size:
            return np.where(torque > 0.0, torque / self.efficiency, torque * self.efficiency)
        found = torque
        for _ in range(_LOSS_STEPS):
            found = torque + self.of(found, speed)
        return found

    def share_left(self, torque: float, speed: float) -> float:
        """Returns the efficiency at a driving torque."""
        if not self.table.values.size:
            return self.efficiency
        return 1.0 - float(self.of(np.asarray(torque), np.asarray(speed))) / torque


@dataclass(frozen=True)
class Gearbox:
    """The automated gearbox with clutch times and driveline.

    Attributes:
      efficiency: of the gears without a loss map. With a map for every gear, that of the highest
        gear at half torque, for models that read no maps.
      driveline_efficiency: behind the gearbox; with an `axle_loss` map, the same.
      ratios: of gears 1 to n, falling, shape (n,).
      inertias: at the gearbox input, per gear [kg m2], shape (n,).
      shifting: parameters of the gearbox controller in addition to the tables.
      upshift: vehicle speed [m/s] over from-gear 1..n-1 (rows) and pedal (columns).
      downshift: vehicle speed [m/s] over from-gear 2..n (rows) and pedal (columns).
      loss_maps: torque loss at the gearbox input [N m] over input speed [rad/s] (rows) and input
        torque [N m] (columns), by name; loss_map: the map of each gear, from 1, or 0 for none.
      axle_loss: the same of the final drive, at the propeller shaft.
    """

    final_drive: Ratio
    efficiency: Efficiency
    driveline_efficiency: Efficiency
    start_gear: Count
    reverse_ratio: Ratio
    shift_cut_time: Seconds
    synchronization_time: Seconds
    synchronization_time_max: Seconds
    synchronized_difference: RadiansPerSecond
    clutch_engagement_time: Seconds
    clutch_close_time: Seconds
    clutch_torque_max: NewtonMeters
    driveline_stiffness: RollStiffness
    driveline_damping: RollDamping
    loss_reversal_speed: RadiansPerSecond
    downshift_delay: Seconds
    downshift_margin: Speed
    min_gear_time: Seconds
    shift_strategy: str
    ratios: FloatArray
    inertias: FloatArray
    shifting: Shifting
    upshift: Table2D = NO_TABLE
    downshift: Table2D = NO_TABLE
    loss_map: tuple[Count, ...] = ()
    loss_maps: dict[str, Table2D] = field(default_factory=dict)
    axle_loss: Table2D = NO_TABLE

    def __post_init__(self) -> None:
        one_of("parameter gearbox.shift_strategy", self.shift_strategy, SHIFT_STRATEGIES)
        gears = len(self.ratios)
        if gears < 2 or (np.diff(self.ratios) >= 0.0).any() or self.ratios[-1] <= 0.0:
            raise InputError("gearbox.gears: two or more gears with falling ratios are needed")
        if not 1 <= self.start_gear <= gears:
            raise InputError(
                f"parameter gearbox.start_gear = {self.start_gear}: allowed is 1 to {gears}"
            )
        for name, table, first in (("upshift", self.upshift, 1), ("downshift", self.downshift, 2)):
            wanted = np.arange(first, first + gears - 1)
            if table.rows.size and not np.array_equal(table.rows, wanted):
                raise InputError(
                    f"gearbox.{name} has rows for gears {table.rows.tolist()}, but the gearbox has "
                    f"{gears}: gears {first} to {first + gears - 2} are needed; without the table, "
                    "shift speeds are made from the full-load curve"
                )

    def completed(self, engine: Engine, radius: float) -> Gearbox:
        """Returns the gearbox with shift tables, made for an engine and wheels if it has none.

        An upshift is due at an engine speed that rises with the pedal from a quarter above the
        speed of full torque to the speed of full power, a downshift at 85 % of what the same
        upshift leaves.
        """
        self = self._with_mean_efficiencies(engine)
        if self.upshift.rows.size and self.downshift.rows.size:
            return self
        pedal = np.linspace(0.0, 1.0, 11)
        torque, speed = engine.full_load_torque, engine.full_load_speed
        full_torque = float(speed[torque >= 0.97 * torque.max()][0])
        full_power = float(speed[np.argmax(torque * speed)])
        up = 1.25 * full_torque + pedal * max(full_power - 1.25 * full_torque, 0.0)
        steps = self.ratios[:-1] / self.ratios[1:]
        lowest = 1.15 * self.shifting.lowest_speed * engine.idle_speed
        up_speeds = np.maximum(up, lowest * steps[:, None] / 0.85)
        down_speeds = 0.85 * up_speeds / steps[:, None]
        meters = radius / self.final_drive
        gears = np.arange(1.0, len(self.ratios) + 1.0)
        upshift = Table2D(gears[:-1], pedal, up_speeds * meters / self.ratios[:-1, None])
        downshift = Table2D(gears[1:], pedal, down_speeds * meters / self.ratios[1:, None])
        given_up, given_down = self.upshift.rows.size, self.downshift.rows.size
        return dataclasses.replace(
            self,
            upshift=self.upshift if given_up else upshift,
            downshift=self.downshift if given_down else downshift,
        )

    @property
    def gear_losses(self) -> tuple[Loss, ...]:
        """The losses of each gear."""
        maps = [NO_TABLE, *self.loss_maps.values()]
        numbers = self.loss_map or (0,) * len(self.ratios)
        return tuple(Loss(self.efficiency, maps[number]) for number in numbers)

    @property
    def final_drive_loss(self) -> Loss:
        """The losses behind the gearbox."""
        return Loss(self.driveline_efficiency, self.axle_loss)

    def gear_efficiencies(self, engine: Engine) -> FloatArray:
        """Returns the efficiency of each gear, (n,); by its map at half torque."""
        speed, torque = engine.half_torque
        return np.array([loss.share_left(torque, speed) for loss in self.gear_losses])

    def _with_mean_efficiencies(self, engine: Engine) -> Gearbox:
        """The gearbox with efficiencies from its loss maps, in the highest gear at half torque."""
        found: dict[str, Any] = {}
        if self.loss_map and all(self.loss_map):
            found["efficiency"] = float(self.gear_efficiencies(engine)[-1])
        speed, torque = engine.half_torque
        if self.axle_loss.values.size:
            ratio = float(self.ratios[-1])
            left = self.final_drive_loss.share_left(torque * ratio, speed / ratio)
            found["driveline_efficiency"] = left
        return dataclasses.replace(self, **found) if found else self
