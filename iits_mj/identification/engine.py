"""Scales of the engine's torque map and drag, and lag and rise of its torque.

The engine of the powertrain plugin runs on a test bench, a rotor at the recorded engine speed, with
the recorded pedal; its torque is fitted to the recorded torque. So the identified engine is that of
the truck, not a copy of its equations. The bench's gearbox has a single ratio: the engine turns
with the rotor, and the controller does not change gear.

The bench begins without torque and charge. So does an engine that has coasted for a while, and its
next torque shows lag and rise. After a gear change some charge is left, and only the later torque
counts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, fit, unseen
from iits_mj.identification.log import Log, Series
from iits_mj.model import powertrain
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tables import Table2D
from iits_mj.plugin import register

_PEDAL = "command_accelerator_pedal"
_NEEDED = ("engine_torque", "engine_speed", _PEDAL, "shift_in_process")
NAMES = ("torque_map_scale", "engine_drag_scale", "boost_lag", "torque_rise_rate")
# Time step of the bench, and longest stretch of the log on it [s].
_STEP = 0.005
_WINDOW = 12.0
# Errors of the estimates by the bench's step, and by a pedal that moves between the rows of a
# table, measured against the truck: shares of the value in the order of `NAMES`. A table's rows
# hide the mean time of pedal steps by this share of their period.
_BUS_ERRORS = (0.001, 0.003, 0.01, 0.003)
_TABLE_ERRORS = (0.007, 0.02, 0.01, 0.02)
_TABLE_ONSET = 0.2
# Times after which the charge is gone: without pedal, and after a gear change [s].
_COASTED = 3.0
_FORGOTTEN = 8.0
_COUNTED_MIN = 1.0
# More stretches than this, evenly over the log, add time and little knowledge.
_WINDOWS_MAX = 40
# Time for which a coasting engine runs on the bench before the pedal goes down [s].
_BEFORE = 1.0
_PEDAL_UP = 0.01
# The clutch is closed above this share of idle speed.
_SPEED_MIN = 1.3
# A rotor that the engine cannot disturb, and the gain of the machine that drives it.
_INERTIA = 1e4
_GAIN = 1e6
# Vehicle speeds [m/s] at which the bench's gearbox would change up and down: never.
_NEVER_UP, _NEVER_DOWN = 199.0, 0.0
_DELAY = 10.0
_SIGNALS = ("engine_torque", "shift_in_process", "clutch_engagement")


@dataclass(frozen=True)
class _Window:
    """A stretch of the log.

    Attributes:
      grid: times of the bench's steps from its start [s], shape (n,).
      engine_speed: [rad/s]; pedal: 0 to 1; both on the grid.
      time, torque: the counted part of the record, from the start [s], [N m], shape (m,).
    """

    grid: FloatArray
    engine_speed: FloatArray
    pedal: FloatArray
    time: FloatArray
    torque: FloatArray


def _torques(parameters: TruckParameters, windows: Sequence[_Window]) -> list[FloatArray]:
    """Crankshaft torque on the bench [N m] in each window, (n,); NaN with an open driveline."""
    model = _model(parameters)
    data = mujoco.MjData(model)
    longest = max(len(w.pedal) for w in windows)
    states, controls = [], np.zeros((len(windows), longest, model.nu))
    pedal, machine = (
        int(model.actuator_ctrladr[model.actuator(n).id]) for n in ("accelerator_pedal", "machine")
    )
    for index, window in enumerate(windows):
        mujoco.mj_resetData(model, data)
        data.qvel[0] = window.engine_speed[0]
        states.append(_state(model, data))
        for column, values in ((pedal, window.pedal), (machine, window.engine_speed)):
            controls[index, : len(values), column] = values
            controls[index, len(values) :, column] = values[-1]
    _, sensors = rollout.rollout(model, data, np.array(states), controls)
    torque, shifting, engagement = (
        sensors[:, :, int(model.sensor(name).adr[0])] for name in _SIGNALS
    )
    closed = (shifting < 0.5) & (engagement > 0.99)
    torque = np.where(closed, torque, np.nan)
    return [np.asarray(row[: len(w.pedal)]) for row, w in zip(torque, windows, strict=True)]


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def _model(parameters: TruckParameters) -> mujoco.MjModel:
    register()
    gearbox = parameters.gearbox
    gears = len(gearbox.ratios)

    def never(table: Table2D, speed: float) -> Table2D:
        return dataclasses.replace(table, values=np.full_like(table.values, speed))

    single = dataclasses.replace(
        gearbox,
        final_drive=1.0,
        # The plugin needs falling ratios; these fall by a millionth.
        ratios=1.0 - 1e-6 * np.arange(gears, dtype=np.float64),
        start_gear=gears,
        downshift_delay=_DELAY,
        upshift=never(gearbox.upshift, _NEVER_UP),
        downshift=never(gearbox.downshift, _NEVER_DOWN),
    )
    config = powertrain.config(dataclasses.replace(parameters, gearbox=single))
    attributes = "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
    sensors = "".join(
        f'<plugin name="{name}" plugin="iits.powertrain" instance="powertrain"/>'
        for name in _SIGNALS
    )
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{_STEP}" integrator="implicitfast" gravity="0 0 0"/>
        <extension><plugin plugin="iits.powertrain">
          <instance name="powertrain">{attributes}</instance>
        </plugin></extension>
        <worldbody><body name="rotor"><joint name="rotor" axis="1 0 0"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{_INERTIA} {_INERTIA} {_INERTIA}"/>
        </body></worldbody>
        <tendon><fixed name="shaft"><joint joint="rotor" coef="1"/></fixed></tendon>
        <actuator>
          <plugin name="accelerator_pedal" plugin="iits.powertrain" instance="powertrain"
            tendon="shaft"/>
          <velocity name="machine" joint="rotor" kv="{_GAIN}"/>
        </actuator>
        <sensor>{sensors}</sensor>
      </mujoco>""")


def identify_engine(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Fits scales of torque map and drag, boost lag and rate of rise."""
    engine = parameters.engine
    free = [
        Free("torque_map_scale", "1", 1.0, 0.3, 2.0),
        Free("engine_drag_scale", "1", 1.0, 0.2, 4.0),
        Free("boost_lag", "s", engine.boost_lag, 0.01, 5.0),
        Free("torque_rise_rate", "N m/s", engine.torque_rise_rate, 20.0, 5000.0),
    ]

    lacks = log.lacks(*_NEEDED)
    if lacks:
        return unseen(free, lacks)
    windows = _windows(log, parameters)
    if not windows:
        return unseen(free, "the log has no stretch in one gear after coasting or a change")

    def residual(values: FloatArray) -> list[FloatArray]:
        trial = with_engine(parameters, dict(zip(NAMES, map(float, values), strict=True)))
        groups = []
        found = _torques(trial, windows)
        for window, torque in zip(windows, found, strict=True):
            model = np.interp(window.time, window.grid, torque)
            error = (model - window.torque) / engine.reference_torque
            groups.append(np.where(np.isfinite(error), error, 0.0))
        return groups

    estimates, _ = fit(free, residual, step=1e-3, tolerance=1e-5)
    if _continuous(log):
        return [e.widened(share) for e, share in zip(estimates, _BUS_ERRORS, strict=True)]
    late = _TABLE_ONSET * float(np.median(np.diff(log.series(_PEDAL).time)))
    scale, drag, lag, rise = (
        e.widened(share) for e, share in zip(estimates, _TABLE_ERRORS, strict=True)
    )
    return [scale, drag, lag.widened(late / lag.value), rise]


def with_engine(parameters: TruckParameters, values: dict[str, float]) -> TruckParameters:
    """The truck with these values of `NAMES`; the other values stay."""
    engine = parameters.engine
    scale, drag = values.get("torque_map_scale", 1.0), values.get("engine_drag_scale", 1.0)
    pedal_map = dataclasses.replace(engine.pedal_map, values=scale * engine.pedal_map.values)
    changed = dataclasses.replace(
        engine,
        pedal_map=pedal_map,
        full_load_torque=scale * engine.full_load_torque,
        drag_torque=tuple(drag * torque for torque in engine.drag_torque),
        boost_lag=values.get("boost_lag", engine.boost_lag),
        torque_rise_rate=values.get("torque_rise_rate", engine.torque_rise_rate),
    )
    return dataclasses.replace(parameters, engine=changed)


def _windows(log: Log, parameters: TruckParameters) -> list[_Window]:
    """Stretches of up to 12 s in one gear that begin after coasting or after a gear change."""
    series = log.series("engine_torque")
    time = series.time
    lowest = _SPEED_MIN * parameters.engine.idle_speed
    good = (log.held("shift_in_process", time) < 0.5) & (log.at("engine_speed", time) > lowest)
    for name in ("command_engine_brake", "command_xbr_mode", "command_brake_pedal"):
        if name in log:
            good &= log.held(name, time) < 1e-3
    windows = []
    for begin, counted in _starts(log):
        start = int(np.searchsorted(time, begin))
        stop = start
        while stop < len(time) and good[stop] and time[stop] - begin <= _WINDOW:
            stop += 1
        if stop <= start or time[stop - 1] - counted < _COUNTED_MIN:
            continue
        grid = np.arange(0.0, time[stop - 1] - begin + _STEP, _STEP)
        speed = log.at("engine_speed", begin + grid)
        pedal = np.clip(_pedal(log, begin + grid), 0.0, 1.0)
        part = np.arange(start, stop)[time[start:stop] >= counted]
        windows.append(_Window(grid, speed, pedal, time[part] - begin, series.value[part]))
    return windows[:: -(-len(windows) // _WINDOWS_MAX) or 1]


def _continuous(log: Log) -> bool:
    """Whether the log has each position of the pedal when it is given, as a bus has."""
    return isinstance(log.signals[_PEDAL], Series)


def _pedal(log: Log, time: FloatArray) -> FloatArray:
    """The pedal's position at other times.

    On a bus a position holds until the next frame. A table shows it up to a row late: a straight
    line between rows has the right time on average.
    """
    return log.held(_PEDAL, time) if _continuous(log) else log.at(_PEDAL, time)


def _starts(log: Log) -> list[tuple[float, float]]:
    """Times at which a bench run may begin, and from which its torque counts [s]."""
    shifts = log.series("shift_in_process")
    ends = shifts.time[1:][np.diff(shifts.value) < -0.5]
    starts = [(float(end), float(end) + _FORGOTTEN) for end in ends]
    pedal = log.series(_PEDAL)
    up = pedal.value > _PEDAL_UP
    pressed = np.flatnonzero(up[1:] & ~up[:-1]) + 1
    for index in pressed:
        last = np.flatnonzero(up[:index])
        since = pedal.time[last[-1] + 1] if len(last) else pedal.time[0]
        begin = float(pedal.time[index]) - _BEFORE
        if begin - since > _COASTED:
            starts.append((begin, begin + 0.5 * _BEFORE))
    return starts
