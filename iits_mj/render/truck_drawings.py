"""Drawings of a truck from its parameters: views, turns, gears, traction, engine, brakes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from iits_mj.analytic.swept_path import Turn, TurningCircle
from iits_mj.analytic.wheel_force import full_load_force, overall_ratio, resistance
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY, KMH, RPM
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters, Unit
from iits_mj.parameters.mass_state import laden_units, static_axle_loads
from iits_mj.render.plots import GRID, INK, PALETTE, dress

CLIMBS = (0.0, 0.02, 0.04, 0.06, 0.08, 0.10, 0.12)
_DESCENTS = (0.02, 0.04, 0.06, 0.08)
_SPEED_MAX = 130.0  # [km/h] of the gear diagram
_CAB, _CAB_LOW, _FRAME, _FRAME_DEPTH, _BODY = 2.3, 0.45, 1.0, 0.25, 1.15  # [m]
_BODY_COLORS = (PALETTE[0], PALETTE[5], PALETTE[4], PALETTE[2])


def draw_views(p: TruckParameters) -> Figure:
    """Returns side and top view to scale, with axle positions, loads and centers of gravity."""
    figure, (side, top) = _figure(2, (11.0, 6.0), height_ratios=(1.5, 1.0))
    origin, axles, place = 0.0, [], {}
    bodies = laden_units(p, p.payload_max)
    for i, (unit, laden) in enumerate(zip(p.units, bodies, strict=True)):
        origin += unit.coupling.position if unit.coupling else 0.0
        _side_view(side, p, unit, origin, _BODY_COLORS[i % len(_BODY_COLORS)])
        _top_view(top, p, unit, origin, _BODY_COLORS[i % len(_BODY_COLORS)])
        side.plot(origin + laden.cg_position, laden.cg_height, "P", color=INK, ms=8, zorder=6)
        if unit.coupling:
            side.plot(origin, unit.coupling.height, "v", color=PALETTE[1], ms=7, zorder=6)
        place[unit.name] = origin
        axles += [origin + axle.position for axle in unit.axles]
    side.axhline(0.0, color=INK, linewidth=1.0)
    loads = [static_axle_loads(p, payload) / 1e3 for payload in (0.0, p.payload_max)]
    front = -p.lead.front_overhang
    for at, empty, laden_load in zip(axles, *loads, strict=True):
        text = f"{empty:.0f}\n{laden_load:.0f}"
        side.text(at, -0.25, text, ha="center", va="top", fontsize=8, color=INK)
    side.text(front - 0.2, -0.25, "kN empty\nladen", ha="right", va="top", fontsize=8, color=INK)
    for a, b in zip([front, *axles], [*axles, p.rear], strict=True):
        side.annotate("", (a, -1.55), (b, -1.55), arrowprops={"arrowstyle": "<->", "color": INK})
        side.text(
            0.5 * (a + b), -1.65, f"{b - a:.2f}", ha="center", va="top", fontsize=7, color=INK
        )
    side.set_ylim(-2.2, max(unit.height for unit in p.units) + 0.4)
    dress(side, f"{p.length:.2f} m; + center of gravity, laden; \u25bc coupling; distances in m")
    dress(top, "plan view")
    for ax in (side, top):
        ax.set_aspect("equal")
        ax.set_xlim(front - 2.2, p.rear + 0.6)
        ax.set_ylabel("[m]")
    half = 0.5 * max(unit.width for unit in p.units) + 0.3
    top.set_ylim(-half, half)
    return figure


def _side_view(ax: Axes, p: TruckParameters, unit: Unit, origin: float, color: str) -> None:
    front, rear = origin - unit.front_overhang, origin - unit.front_overhang + unit.length

    def box(start: float, end: float, low: float, high: float) -> None:
        shape = Rectangle((start, low), end - start, high - low, facecolor=color + "55", ec=color)
        ax.add_patch(shape)

    box(front, rear, _FRAME - _FRAME_DEPTH, _FRAME)
    if unit.coupling is None:
        box(front, front + _CAB, _CAB_LOW, unit.height)
        front += _CAB + 0.1
    elif front > origin:
        ax.plot([origin, front], [unit.coupling.height, _FRAME - 0.1], color=color, linewidth=3)
    if unit.kind not in ("tractor", "dolly"):
        box(front, rear, _BODY, unit.height)
    for axle in unit.axles:
        radius = p.tires[axle.tire].free_radius
        wheel = Circle((origin + axle.position, radius), radius, fc="#3a444d", ec=INK, zorder=4)
        ax.add_patch(wheel)
        ax.plot(origin + axle.position, radius, "o", color="w", ms=4, zorder=5)
        if axle.lifted(0.0):
            ax.text(
                origin + axle.position, 2.2 * radius, "lifts", ha="center", fontsize=7, zorder=7
            )


def _top_view(ax: Axes, p: TruckParameters, unit: Unit, origin: float, color: str) -> None:
    front = origin - unit.front_overhang
    low = -0.5 * unit.width
    ax.add_patch(Rectangle((front, low), unit.length, unit.width, fc=color + "33", ec=color))
    for axle in unit.axles:
        tire = p.tires[axle.tire]
        width, count = 0.3 if tire.count > 1 else 0.35, int(tire.count)
        for side in (-0.5, 0.5):
            for k in range(count):
                middle = side * axle.track + (k - 0.5 * (count - 1)) * 0.34
                corner = (origin + axle.position - tire.free_radius, middle - 0.5 * width)
                color_of = PALETTE[1] if axle.driven else "#3a444d"
                ax.add_patch(
                    Rectangle(corner, 2 * tire.free_radius, width, fc=color_of, ec=INK, alpha=0.8)
                )


def draw_turn(done: Turn, circle: TurningCircle) -> Figure:
    """Returns the swept path of a low-speed turn beside the turning circle at full lock."""
    figure, (path, lock) = _figure(2, (11.0, 5.2), columns=True)
    corners = done.tracks()
    for unit in range(corners.shape[1]):
        color = _BODY_COLORS[unit % len(_BODY_COLORS)]
        for corner in range(4):
            path.plot(*corners[:, unit, corner].T, color=color, linewidth=0.7, alpha=0.6)
        for place in np.linspace(0, 0.7 * len(corners), 6).astype(int):
            shape = Polygon(corners[place, unit], closed=True, fc=color + "33", ec=color)
            path.add_patch(shape)
    path.plot(*done.path.T, color=INK, linewidth=1.4, linestyle="--")
    length = float(np.hypot(*(corners[0, 0, 0] - corners[0, -1, 3])))
    path.set_xlim(-1.1 * length, done.radius + 2.0)
    path.set_ylim(-2.0, done.radius + 0.9 * length)
    degrees = math.degrees(done.angle)
    dress(path, f"turn of {degrees:.0f} degrees, outer steer tire on {done.radius:g} m (dashed)")
    for what, diameter, color in (
        ("wall to wall", circle.wall, PALETTE[1]),
        ("curb to curb", circle.curb, PALETTE[0]),
    ):
        edge = Circle((0.0, 0.0), 0.5 * diameter, fill=False, ec=color, lw=1.8)
        edge.set_label(f"{what}: {diameter:.1f} m")
        lock.add_patch(edge)
    outline = done.outline
    radius = math.sqrt(max(0.25 * circle.curb**2 - outline.kinematic.L**2, 0.0)) - outline.tire
    half = 0.5 * float(outline.width[0])
    front, rear = float(outline.front[0]), float(outline.rear[0])
    box = [(rear, half), (front, half), (front, -half), (rear, -half)]
    motor = np.array([(along, across - radius) for along, across in box])
    lock.add_patch(Polygon(motor, closed=True, fc=_BODY_COLORS[0] + "55", ec=_BODY_COLORS[0]))
    reach = 0.55 * circle.wall
    lock.set_xlim(-reach, reach)
    lock.set_ylim(-reach, reach)
    dress(lock, "motor vehicle at full lock")
    lock.legend(loc="center", fontsize=8, frameon=False)
    for ax in (path, lock):
        ax.set_aspect("equal")
        ax.set_xlabel("[m]")
    return figure


def draw_gears(p: TruckParameters) -> Figure:
    """Returns the gear diagram: vehicle speed over engine speed in each gear."""
    figure, (ax,) = _figure(1, (9.5, 4.2))
    engine = np.array([p.engine.idle_speed, p.engine.governed_speed])
    for gear in range(1, len(p.gearbox.ratios) + 1):
        speed = engine / overall_ratio(p, gear)
        ax.plot(engine / RPM, speed / KMH, color=PALETTE[0])
        top = min(float(speed[1]) / KMH, 0.97 * _SPEED_MAX)
        at = (top * KMH * overall_ratio(p, gear) + 10.0 * RPM, top)
        ax.text(at[0] / RPM, at[1], str(gear), fontsize=8, va="center")
    ax.axhline(85.0, color=PALETTE[1], linestyle="--", linewidth=1.2)
    full = p.engine.full_load_torque
    band = p.engine.full_load_speed[full >= 0.97 * full.max()] / RPM
    ax.axvspan(band[0], band[-1], color=PALETTE[2], alpha=0.15)
    ax.set_xlabel("engine speed [rpm]")
    ax.set_ylabel("speed [km/h]")
    ax.set_ylim(0.0, _SPEED_MAX)
    dress(ax, "gears; dashed: 85 km/h; band: 97 % of the greatest torque")
    return figure


def draw_traction(p: TruckParameters, payload: float) -> Figure:
    """Returns engine power and torque, and wheel force per gear with resistances on climbs."""
    figure, (engine, force) = _figure(2, (9.5, 8.0))
    speed, torque = full_load(p)
    engine.plot(speed / RPM, torque, color=PALETTE[0], label="torque [N m]")
    power = engine.twinx()
    power.plot(speed / RPM, speed * torque / 1e3, color=PALETTE[1], label="power [kW]")
    power.set_ylim(bottom=0.0)
    engine.set_ylim(bottom=0.0)
    engine.set_xlabel("engine speed [rpm]")
    engine.set_ylabel("torque [N m]", color=PALETTE[0])
    power.set_ylabel("power [kW]", color=PALETTE[1])
    dress(engine, "full load of the engine")
    highest = 0.0
    for gear in range(1, len(p.gearbox.ratios) + 1):
        at, pull = full_load_force(p, gear)
        highest = max(highest, float(pull.max()))
        force.plot(at / KMH, pull / 1e3, color=PALETTE[0], linewidth=1.4)
        force.text(at[0] / KMH, pull[0] / 1e3, str(gear), fontsize=7, ha="right")
    _grade_lines(force, p, payload, CLIMBS)
    force.set_ylim(0.0, 1.05 * highest / 1e3)
    mass = p.gross_mass(payload) / 1e3
    dress(force, f"wheel force at full load per gear, and resistance of {mass:.1f} t on climbs")
    return figure


def _grade_lines(
    ax: Axes, p: TruckParameters, payload: float, grades: Sequence[float], sign: float = 1.0
) -> None:
    """Draws the resistance over speed, or the downhill force (sign -1), for each grade."""
    speed = np.linspace(0.0, 120.0, 61) * KMH
    for grade in grades:
        needed = sign * resistance(p, payload, speed, sign * grade) / 1e3
        ax.plot(speed / KMH, needed, color=PALETTE[1], linewidth=1.0, linestyle="--")
        ax.text(120.5, needed[-1], f"{100 * grade:.0f} %", fontsize=8, va="center", clip_on=True)
    ax.set_xlim(0.0, 127.0)
    ax.set_xlabel("speed [km/h]")
    ax.set_ylabel("force at the wheels [kN]")


def draw_engine_map(p: TruckParameters) -> Figure:
    """Returns the engine's brake specific fuel consumption [g/kWh] below full load."""
    figure, (ax,) = _figure(1, (9.5, 4.6))
    speed, full = full_load(p)
    at, torque = np.meshgrid(
        np.linspace(speed[0], speed[-1], 90), np.linspace(0.05, 1.0, 90) * full.max()
    )
    values = np.ma.masked_where(torque > np.interp(at, speed, full), specific_fuel(p, at, torque))
    best = float(values.min())
    levels = best * np.array([1.005, 1.01, 1.02, 1.035, 1.05, 1.08, 1.12, 1.2, 1.35, 1.6])
    lines = ax.contour(at / RPM, torque, values, levels=levels, cmap="viridis_r")
    ax.clabel(lines, fmt="%.0f", fontsize=8)
    ax.plot(speed / RPM, full, color=INK, linewidth=2.0)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("engine speed [rpm]")
    ax.set_ylabel("torque [N m]")
    dress(ax, f"fuel [g/kWh], at best {best:.1f}")
    return figure


def specific_fuel(p: TruckParameters, speed: FloatArray, torque: FloatArray) -> FloatArray:
    """Returns the engine's fuel [g/kWh] at speeds [rad/s] and torques [N m], same shape."""
    engine, flat = p.engine, (speed.ravel(), torque.ravel())
    if engine.fuel_map.values.size:
        found = [engine.fuel_map.at(t, w) for w, t in zip(*flat, strict=True)]
    else:
        rate = engine.fuel_rate_map
        found = [rate.at(w, t) / (w * t) for w, t in zip(*flat, strict=True)]
    return engine.fuel_factor * 3.6e9 * np.array(found).reshape(speed.shape)


def draw_retarding(p: TruckParameters, payload: float) -> Figure:
    """Returns the braking forces of engine and retarder, and what descents need."""
    figure, (ax,) = _figure(1, (9.5, 4.4))
    engine, retarder, radius = p.engine, p.retarder, p.tires[p.driven_axles[0].tire].rolling_radius
    speed = np.linspace(engine.idle_speed, 1.1 * engine.governed_speed, 60)
    drag = np.interp(speed, engine.drag_speed, np.abs(engine.drag_torque))
    power = engine.engine_brake_power * (speed / engine.engine_brake_speed) ** (
        engine.engine_brake_exponent
    )
    brake = np.where(speed > engine.engine_brake_speed_min, power / speed, 0.0)
    for gear in range(1, len(p.gearbox.ratios) + 1):
        ratio = overall_ratio(p, gear)
        label = "engine drag and engine brake, per gear" if gear == 1 else None
        ax.plot(
            speed / ratio / KMH, (drag + brake) * ratio / 1e3, color=PALETTE[0], lw=1.0, label=label
        )
    if retarder.torque_max:
        at = np.linspace(1.0, 120.0 * KMH, 120)
        shaft = at / radius * p.gearbox.final_drive
        rising = np.minimum(1.0, shaft / retarder.full_torque_speed) ** 2
        for limit, style, label in (
            (retarder.power_max, "-", "retarder, cold"),
            (retarder.power_continuous, ":", "retarder, hot"),
        ):
            torque = np.minimum(retarder.torque_max * rising, limit / shaft)
            force = torque * p.gearbox.final_drive / radius / 1e3
            ax.plot(at / KMH, force, color=PALETTE[2], linestyle=style, lw=2.0, label=label)
    _grade_lines(ax, p, payload, _DESCENTS, -1.0)
    ax.set_ylim(0.0, 0.12 * p.gross_mass(payload) * GRAVITY / 1e3)
    dress(ax, f"braking without friction; dashed: {p.gross_mass(payload) / 1e3:.1f} t on descents")
    ax.legend(loc="upper right", fontsize=8, frameon=False)
    return figure


def draw_bars(groups: Sequence[tuple[str, str, Sequence[tuple[str, FloatArray]]]]) -> Figure:
    """Returns one panel of bars for each (title, unit, bars); bars are (truck, values)."""
    figure, axes = _figure(len(groups), (9.5, 2.6 * len(groups)))
    for ax, (title, unit, bars) in zip(axes, groups, strict=True):
        width = 0.8 / len(bars)
        for i, (name, values) in enumerate(bars):
            at = np.arange(len(values)) + i * width
            ax.bar(at, values, width, label=name, color=PALETTE[i % len(PALETTE)])
        most = max(len(values) for _, values in bars)
        ax.set_xticks(np.arange(most) + 0.4 - 0.5 * width, [str(k + 1) for k in range(most)])
        ax.set_ylabel(unit)
        dress(ax, title)
    axes[0].legend(fontsize=8, frameon=False, ncols=3)
    return figure


def _figure(
    count: int,
    size: tuple[float, float],
    *,
    columns: bool = False,
    height_ratios: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    rows, across = (1, count) if columns else (count, 1)
    axes = figure.subplots(rows, across, squeeze=False, height_ratios=height_ratios)
    for ax in axes.flat:
        ax.grid(color=GRID)
    return figure, list(axes.flat)
