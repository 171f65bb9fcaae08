"""Speed tracking on the MuJoCo truck: errors on grades, use of pedal and brakes, starts on a hill.

The error is speed less planned speed where the truck's power suffices: at full pedal the plan waits
for the truck, 0.5 m/s ahead of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import SpeedProfile
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.timing import CONTROL_PERIOD, TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal.hills import HILLS_LENGTH, hills, sloping
from iits_mj.validation.planning.closed_loop import DriveTask, Record, drive

# Positions that count as pressed, and as full pedal [1].
_PRESSED, FLOORED = 0.02, 0.99
# The planned speed leads a truck at full pedal: such samples say nothing about tracking, nor do
# those within this time after full pedal or a gear change [s].
_SETTLING = 3.0
_START = 100.0
_UNLIMITED = 40.0
# Long gentle hills for the laden truck at speed: 412 kW move 55 t up 2 % at about 75 km/h.
_WAVES = (
    (500.0, 0.012, 200.0),
    (1000.0, -0.02, 250.0),
    (1600.0, 0.01, 250.0),
    (2100.0, 0.0, 200.0),
)
_WAVES_LENGTH = 2_500.0
_STEEP = 0.05
# Greatest distance rolled back at a start [m], and the speed at which the start is over [m/s].
_ROLL_BACK, _UNDER_WAY = 0.05, 1.5
_PLOT_ROWS = 10


def run_speed_tracking(config: ValidateConfig) -> Results:
    """Drives hills, changes of speed between 0 and 90 km/h, and starts on a hill."""
    results = Results("planning speed tracking")
    timestep = max(config.step, TIMESTEP)
    for name, task in _tasks(config, timestep).items():
        record = drive(task)
        found = Findings(name, panels=_panels(record))
        _check(found, record)
        results.add(name, found)
    for payload in () if config.quick else config.payloads():
        results.add("", _hill_start(payload, timestep))
    return results


def _tasks(config: ValidateConfig, timestep: float) -> dict[str, DriveTask]:
    """Returns the drives by their names."""

    def task(
        route: Route,
        length: float,
        payload: float,
        speed: float,
        start: float | None = None,
        profile: SpeedProfile | None = None,
    ) -> DriveTask:
        return DriveTask(
            route=route,
            start=_START,
            end=_START + length,
            speed=speed if start is None else start,
            cruise_speed=speed,
            profile=profile,
            payload=payload,
            timestep=timestep,
            time_limit=600.0,
        )

    if config.quick:
        return {"hills at 40 km/h, 19 t": task(hills(), 250.0, 0.0, 40.0 * KMH)}
    tasks: dict[str, DriveTask] = {}
    truck = TruckParameters.load()
    for payload in config.payloads():
        mass = f"{truck.gross_mass(payload) / 1e3:.0f} t"
        fast = 40.0 if payload > 0.5 * truck.payload_max else 75.0
        waves = sloping(_WAVES_LENGTH, 0.0, _WAVES)
        level = Route.straight(length=4_000.0, speed_limit=_UNLIMITED)
        tasks |= {
            f"hills of 4 % at {fast:g} km/h, {mass}": task(
                hills(), HILLS_LENGTH - 200.0, payload, fast * KMH
            ),
            f"waves of 2 % at 85 km/h, {mass}": task(
                waves, _WAVES_LENGTH - 200.0, payload, 85.0 * KMH
            ),
            f"0 to 90 km/h and down to 20, {mass}": task(
                level, 3_500.0, payload, 90.0 * KMH, 0.0, _speed_steps()
            ),
        }
    return tasks


def _speed_steps() -> SpeedProfile:
    """Returns 30, 60 and 90 km/h, then down to 50 and 20."""
    station = np.array([0.0, 300.0, 301.0, 900.0, 901.0, 2500.0, 2600.0, 2900.0, 2950.0, 4000.0])
    speed = np.array([30.0, 30.0, 60.0, 60.0, 90.0, 90.0, 50.0, 50.0, 20.0, 20.0])
    return SpeedProfile(station, speed * KMH)


def _check(found: Findings, record: Record) -> None:
    error = tracking_error(record)
    rms = np.sqrt(np.mean(error**2)) if error.size else np.nan
    found.check("speed error, rms", rms, "m/s", 0.0, "<= 0.3")
    found.check("speed error, greatest", np.abs(error).max(), "m/s", 0.0)
    found.check("pedal and brake take turns", reversals_per_km(record), "1/km", must="<= 10")
    found.check("shortest time between turns", shortest_turn(record), "s", must=">= 1")


def _hill_start(payload: float, timestep: float) -> Findings:
    """Starts from standstill on 5 %: the distance rolled back, and the time to be under way."""
    found = Findings(f"start on 5 %, {TruckParameters.load().gross_mass(payload) / 1e3:.0f} t")
    record = drive(
        DriveTask(
            route=Route.straight(length=1_000.0, grade=_STEEP, speed_limit=_UNLIMITED),
            start=_START,
            end=_START + 25.0,
            speed=0.0,
            cruise_speed=8.0,
            payload=payload,
            timestep=timestep,
            time_limit=120.0,
        )
    )
    under_way = int(np.argmax(record["speed"] >= _UNDER_WAY))
    back = float(record["station"][0] - record["station"].min())
    found.check("rolled back", back, "m", 0.0, f"<= {_ROLL_BACK:g}")
    found.check(f"time to {_UNDER_WAY:g} m/s", record["time"][under_way], "s")
    return found


def _panels(record: Record) -> list[Panel]:
    part = slice(None, None, _PLOT_ROWS)
    station = record["station"][part]

    def line(label: str, column: str, scale: float = 1.0, role: str = "") -> Line:
        return Line(label, station, scale * record[column][part], role)

    speeds = (
        line("planned", "planned", 1.0 / KMH, "reference"),
        line("truck", "speed", 1.0 / KMH, "simulation"),
    )
    actuators = (
        line("accelerator", "pedal"),
        line("engine brake", "engine_brake"),
        line("retarder", "retarder"),
        line("XBR demand [m/s2]", "xbr_demand"),
    )
    place = "station [m]"
    return [
        Panel("Speed", place, "speed [km/h]", speeds),
        Panel("Who acts on it", place, "share [1]", actuators),
        Panel("Gear", place, "gear [-]", (line("gear", "gear"),)),
    ]


def reversals(record: Record) -> FloatArray:
    """Returns the times of changes from accelerator to brakes or back [s].

    Brakes are engine brake, retarder and friction brakes. Pedal, coasting, pedal is no reversal.
    """
    pedal = record["pedal"] > _PRESSED
    brake = (
        (record["engine_brake"] > _PRESSED)
        | (record["retarder"] > _PRESSED)
        | (record["xbr_demand"] < 0.0)
    )
    acting = np.where(pedal, 1, np.where(brake, -1, 0))
    rows = np.flatnonzero(acting)
    turns = rows[1:][np.diff(acting[rows]) != 0]
    return np.asarray(record["time"][turns])


def reversals_per_km(record: Record) -> float:
    """Returns the number of reversals per distance [1/km]."""
    return 1e3 * reversals(record).size / max(record.length, 1.0)


def shortest_turn(record: Record) -> float:
    """Returns the least time between reversals [s]; the drive's for fewer than two."""
    times = reversals(record)
    if times.size < 2:
        return float(record["time"][-1] - record["time"][0])
    return float(np.diff(times).min())


def gear_changes(record: Record) -> int:
    """Returns the number of changes of the engaged gear."""
    gear = record["gear"]
    return int(np.count_nonzero(np.diff(gear[gear > 0.0])))


def full_load_share(record: Record) -> float:
    """Returns the share of the time at full pedal [1]."""
    return float(np.mean(record["pedal"] >= FLOORED))


def gained(record: Record, counter: str) -> float:
    """Returns the increase of a counter, such as `brake_work` [J], over the drive."""
    column = record[counter]
    return float(column[-1] - column[0])


def within_power(record: Record) -> NDArray[np.bool_]:
    """Returns a mask of the samples at which the truck could follow, shape (n,)."""
    floored = record["pedal"] >= FLOORED
    width = round(_SETTLING / CONTROL_PERIOD)
    recent = np.convolve(floored.astype(float), np.ones(width), "full")[: floored.size] > 0.5
    return np.asarray(~recent)


def tracking_error(record: Record) -> FloatArray:
    """Returns speed less planned speed where the truck could follow [m/s]."""
    return np.asarray((record["speed"] - record["planned"])[within_power(record)])
