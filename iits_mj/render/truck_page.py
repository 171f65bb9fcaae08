"""Pages of trucks: one truck described, and several compared, with simulated drives."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from iits_mj.analytic.swept_path import Outline, TurningCircle, swept_width, turn, turning_circle
from iits_mj.analytic.wheel_force import full_load_force, resistance
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import TransmissionMode
from iits_mj.core.results import Line, Panel, aligned
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import provenance
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.render import plots, truck_drawings
from iits_mj.render.interactive import Plot
from iits_mj.render.offscreen import Offscreen
from iits_mj.render.pages import Page, Section, picture_section
from iits_mj.truck import Truck
from iits_mj.truck.check import Inspection, inspect_truck

TURN_RADIUS = 12.5  # [m], of the outer steer tire, PBS and 96/53/EC
FULL_PEDAL_SPEED, FULL_PEDAL_TIME = 90.0 * KMH, 240.0
COAST_SPEEDS, COAST_TIME = (90.0 * KMH, 40.0 * KMH), 400.0
_PERIOD = 0.2  # [s] between two samples of a drive


@dataclass(frozen=True, slots=True)
class Maneuvers:
    """Turning figures of a truck.

    Attributes:
      circle: of the motor vehicle at full lock.
      width: of the swept path in a turn of 90 degrees with `TURN_RADIUS` [m].
    """

    circle: TurningCircle
    width: float

    @classmethod
    def of(cls, p: TruckParameters) -> Maneuvers:
        """Computes the figures by the kinematics of the combination."""
        outline = Outline.from_parameters(p)
        circle = turning_circle(outline, p.steering.angle_max / p.steering.ratio)
        return cls(circle, swept_width(turn(outline, TURN_RADIUS).sides(), TURN_RADIUS))

    def rows(self) -> list[tuple[str, str]]:
        """Pairs of text for a table."""
        return [
            ("turning circle, wall to wall", f"{self.circle.wall:.1f} m"),
            ("turning circle, curb to curb", f"{self.circle.curb:.1f} m"),
            (f"swept width, 90 degrees at {TURN_RADIUS:g} m", f"{self.width:.2f} m"),
        ]


def truck_page(truck: str | Path, version: str) -> Page:
    """Returns the page of one truck: drawings, loads, turns, powertrain, provenance.

    Raises:
      InputError: the truck's file is wrong, or no truck can be built from it.
    """
    found, p = inspect_truck(truck), TruckParameters.load(truck)
    maneuvers, outline = Maneuvers.of(p), Outline.from_parameters(p)
    drawn = {
        "Views": truck_drawings.draw_views(p),
        "Low-speed turns": truck_drawings.draw_turn(turn(outline, TURN_RADIUS), maneuvers.circle),
        "Gear diagram": truck_drawings.draw_gears(p),
        "Power and traction": truck_drawings.draw_traction(p, p.payload_max),
        "Engine map": truck_drawings.draw_engine_map(p),
        "Engine brake and retarder": truck_drawings.draw_retarding(p, p.payload_max),
    }
    # The drawings from the file, the loads from a simulated truck at rest.
    pictures = [picture_section(name, plots.to_png(figure)) for name, figure in drawn.items()]
    lead = f"{p.description or 'a truck'}; iits-mj {version}"
    return Page(
        p.name,
        lead,
        [
            Section(notes=found.warnings),
            pictures[0],
            Section("Figures", header=("", ""), rows=[*found.summary, *maneuvers.rows()]),
            *pictures[1:],
            Section(
                "Provenance",
                sentences=[
                    "Grades: P printed in the paper, R read from its authors' public release, D "
                    "derived, L literature or standard, J our judgement."
                ],
                header=("figure", "value", "unit", "grade", "source"),
                rows=provenance(truck),
            ),
        ],
    )


def compare_page(trucks: Sequence[str | Path], version: str) -> tuple[Page, str]:
    """Returns the page that compares trucks, laden, and its table as text.

    Full pedal and coast-down are simulated on a level road without wind.

    Raises:
      InputError: a truck's file is wrong.
    """
    all_found = [inspect_truck(truck) for truck in trucks]
    loaded = [TruckParameters.load(truck) for truck in trucks]
    turns = [Maneuvers.of(p) for p in loaded]
    names = _distinct([found.name for found in all_found])
    pulls = [full_pedal(p) for p in loaded]
    rolls = [coast_down(p) for p in loaded]
    rows = _rows(all_found, turns, pulls, rolls)
    header = ("", *names)
    shown = dict(zip(names, loaded, strict=True))
    panels = {
        "Traction and power": _traction_panels(shown),
        "Full pedal and coast-down, simulated": [
            _speed_panel("full pedal from a standstill", names, pulls),
            _speed_panel("coasting in neutral", names, rolls),
        ],
    }
    bars = truck_drawings.draw_bars(
        [
            *(
                (
                    f"axle loads, {state}; axles from the front",
                    "[kN]",
                    [
                        (name, static_axle_loads(p, share * p.payload_max) / 1e3)
                        for name, p in shown.items()
                    ],
                )
                for state, share in (("empty", 0.0), ("laden", 1.0))
            ),
            (
                "1 wall to wall, 2 curb to curb, 3 swept width in 90 degrees",
                "[m]",
                [
                    (name, np.array([t.circle.wall, t.circle.curb, t.width]))
                    for name, t in zip(names, turns, strict=True)
                ],
            ),
        ]
    )
    page = Page(
        " and ".join(names),
        f"trucks compared, laden; iits-mj {version}",
        [
            Section("Figures", header=header, rows=rows),
            *(
                Section(name, plots=[Plot((panel,)) for panel in drawn])
                for name, drawn in panels.items()
            ),
            picture_section("Loads and turns", plots.to_png(bars)),
        ],
    )
    return page, _text((header, *rows))


def photo(p: TruckParameters, size: tuple[int, int] = (1280, 720)) -> bytes:
    """Returns a PNG picture of the laden truck on a straight road.

    Raises:
      RenderError: OpenGL is missing.
    """
    truck = Truck.load(parameters=p)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = -0.5 * (p.rear - p.lead.front_overhang), 0.0, 1.4
    camera.lookat += truck.data.body("tractor").xpos
    camera.distance, camera.azimuth, camera.elevation = 0.8 * p.length + 4.0, -128.0, -12.0
    with Offscreen(truck.model, size) as renderer:
        renderer.update(truck.data, camera)
        picture = renderer.draw()
    buffer = io.BytesIO()
    Image.fromarray(picture).quantize(128).save(buffer, "png", optimize=True)
    return buffer.getvalue()


def full_pedal(p: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Returns time [s] and speed [m/s] of the laden truck from a standstill at full pedal."""
    truck = Truck.load(parameters=p, visuals=False)
    truck.command(accelerator_pedal=1.0)
    return _drive(truck, lambda speed: speed >= FULL_PEDAL_SPEED, FULL_PEDAL_TIME)


def coast_down(p: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Returns time [s] and speed [m/s] of the laden truck that rolls out in neutral."""
    truck = Truck.load(parameters=p, visuals=False)
    truck.reset(speed=COAST_SPEEDS[0])
    truck.command(transmission_mode=TransmissionMode.NEUTRAL)
    return _drive(truck, lambda speed: speed <= COAST_SPEEDS[1], COAST_TIME)


def _drive(
    truck: Truck, done: Callable[[float], bool], limit: float
) -> tuple[FloatArray, FloatArray]:
    steps = round(_PERIOD / truck.model.opt.timestep)
    time, speed = [truck.time], [truck.read("tractor_velocity")]
    while time[-1] < limit and not done(speed[-1]):
        truck.step(steps)
        time.append(truck.time)
        speed.append(truck.read("tractor_velocity"))
    return np.array(time), np.array(speed)


def time_between(run: tuple[FloatArray, FloatArray], first: float, last: float) -> float:
    """Returns the time [s] from the first to the last speed [m/s]; NaN if one is not reached."""
    time, speed = run
    rising = last > first

    def passed(level: float) -> float:
        beyond = speed >= level if rising else speed <= level
        return float(time[np.argmax(beyond)]) if beyond.any() else math.nan

    return passed(last) - passed(first)


def _rows(
    found: Sequence[Inspection],
    turns: Sequence[Maneuvers],
    pulls: Sequence[tuple[FloatArray, FloatArray]],
    rolls: Sequence[tuple[FloatArray, FloatArray]],
) -> list[tuple[str, ...]]:
    """Rows of the table: summaries, turns, and times of the simulated drives."""
    columns = []
    for inspection, maneuvers, pull, roll in zip(found, turns, pulls, rolls, strict=True):
        times = {
            f"0 to {top} km/h, full pedal": time_between(pull, 0.1, top * KMH)
            for top in (50, 80, 90)
        }
        start, end = (round(speed / KMH) for speed in COAST_SPEEDS)
        times[f"{start - 1} to {end} km/h, coasting"] = time_between(
            roll, (start - 1) * KMH, COAST_SPEEDS[1]
        )
        seconds = {
            key: "not reached" if math.isnan(value) else f"{value:.1f} s"
            for key, value in times.items()
        }
        columns.append(dict(inspection.summary) | dict(maneuvers.rows()) | seconds)
    keys = dict.fromkeys(key for column in columns for key in column)
    return [(key, *(column.get(key, "") for column in columns)) for key in keys]


def _traction_panels(trucks: dict[str, TruckParameters]) -> list[Panel]:
    """Greatest wheel force and power of all gears over speed, and the climb that it allows."""
    speed = np.linspace(3.0, 110.0, 215) * KMH
    forces, powers, climbs = [], [], []
    for name, p in trucks.items():
        gears = [full_load_force(p, gear) for gear in range(1, len(p.gearbox.ratios) + 1)]
        best = np.max([np.interp(speed, *gear, left=0.0, right=0.0) for gear in gears], axis=0)
        forces.append(Line(name, speed / KMH, best / 1e3))
        powers.append(Line(name, speed / KMH, best * speed / 1e3))
        needed = resistance(p, p.payload_max, speed)
        weight = p.gross_mass(p.payload_max) * GRAVITY
        climbs.append(Line(name, speed / KMH, 100.0 * np.maximum(best - needed, 0.0) / weight))
    label = "speed [km/h]"
    return [
        Panel("greatest wheel force", label, "[kN]", tuple(forces)),
        Panel("power at the wheels", label, "[kW]", tuple(powers)),
        Panel("steepest climb at constant speed, laden", label, "[%]", tuple(climbs)),
    ]


def _speed_panel(
    title: str, names: Sequence[str], runs: Sequence[tuple[FloatArray, FloatArray]]
) -> Panel:
    lines = (Line(n, time, speed / KMH) for n, (time, speed) in zip(names, runs, strict=True))
    return Panel(title, "time [s]", "speed [km/h]", tuple(lines))


def _distinct(names: Sequence[str]) -> list[str]:
    """Names with a number where they repeat."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})"
        for i, name in enumerate(names)
    ]


def _text(rows: Sequence[Sequence[str]], widest: int = 56) -> str:
    """Returns a table as lines; long cells are cut."""
    cut = [[c if len(c) <= widest else f"{c[: widest - 3]}..." for c in row] for row in rows]
    return aligned(cut)
