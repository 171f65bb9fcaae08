"""Speed tracking on the MuJoCo truck: errors on grades, who acts on the speed, starts on a hill.

Errors are those of the speed against the planned one, where the truck's power suffices: at full
pedal the plan waits for the truck, half a metre a second ahead of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import SpeedProfile
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal.hills import HILLS_LENGTH, hills, sloping
from iits_mj.validation.planning.closed_loop import DriveTask, Record, drive

# --- How pedal, brakes and gearbox were used on a drive, and how well the speed was kept ---

# Positions that count as pressed, and as floored [1].
_PRESSED, FLOORED = 0.02, 0.99
# The planned speed leads a truck at full pedal: such samples say nothing on tracking. So long after
# the pedal has come back from the floor, and around a gear change, neither [s].
_SETTLING = 3.0


def reversals(record: Record) -> FloatArray:
    """Times at which accelerator and brakes (engine brake, retarder, friction) take turns [s].

    Coasting between them does not count: pedal, coasting, pedal is no reversal.
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
    """Number of reversals over the length driven [1/km]."""
    return 1e3 * reversals(record).size / max(_length(record), 1.0)


def shortest_turn(record: Record) -> float:
    """Least time between two reversals [s]; the whole drive when there are fewer than two."""
    times = reversals(record)
    if times.size < 2:
        return float(record["time"][-1] - record["time"][0])
    return float(np.diff(times).min())


def gear_changes(record: Record) -> int:
    """Number of changes of the gear that is in."""
    gear = record["gear"]
    return int(np.count_nonzero(np.diff(gear[gear > 0.0])))


def full_load_share(record: Record) -> float:
    """Share of the time with the accelerator on the floor [1]."""
    return float(np.mean(record["pedal"] >= FLOORED))


def gained(record: Record, counter: str) -> float:
    """What a counter, as `brake_work` [J], gained over the drive."""
    column = record[counter]
    return float(column[-1] - column[0])


def within_power(record: Record) -> NDArray[np.bool_]:
    """Samples in which the truck could follow: the accelerator was off the floor, shape (n,)."""
    floored = record["pedal"] >= FLOORED
    width = round(_SETTLING / CONTROL_PERIOD)
    recent = np.convolve(floored.astype(float), np.ones(width), "full")[: floored.size] > 0.5
    return np.asarray(~recent)


def tracking_error(record: Record) -> FloatArray:
    """Speed less planned speed where the truck could follow [m/s]."""
    return np.asarray((record["speed"] - record["planned"])[within_power(record)])


def _length(record: Record) -> float:
    return float(record["station"][-1] - record["station"][0])


# --- Speed tracking on the MuJoCo truck: errors on grades, who acts on the speed, starts on a hill

_START = 100.0
_UNLIMITED = 40.0
# Long gentle hills for the laden truck at speed: 412 kW carry 55 t over 2 % at some 75 km/h.
_WAVES = (
    (500.0, 0.012, 200.0),
    (1000.0, -0.02, 250.0),
    (1600.0, 0.01, 250.0),
    (2100.0, 0.0, 200.0),
)
_WAVES_LENGTH = 2_500.0
_STEEP = 0.05
# What the standing start must not lose, and the speed to be reached [m], [m/s].
_ROLL_BACK, _UNDER_WAY = 0.05, 1.5
_PLOT_ROWS = 10


@dataclass(frozen=True)
class Ride:
    """A road, a load [kg] and what speed is wanted: over station, or one all the way [m/s]."""

    name: str
    route: Route
    payload: float
    length: float
    speed: float
    profile: SpeedProfile | None = None
    start_speed: float | None = None


def run_speed_tracking(config: ValidateConfig) -> Results:
    """Drives hills, changes of speed between 0 and 90 km/h, and starts on a hill."""
    results = Results("planning speed tracking")
    timestep = max(config.step, DriveTask.timestep)
    for ride in _rides(config):
        record = _drive(ride, timestep)
        results.checks += _checks(ride, record)
        results.figures[ride.name] = _panels(record)
    if not config.quick:
        for payload in config.payloads():
            results.checks += _hill_start(payload, timestep)
    return results


def _rides(config: ValidateConfig) -> list[Ride]:
    if config.quick:
        return [Ride("hills at 40 km/h, 19 t", hills(), 0.0, 250.0, 40.0 * KMH)]
    rides = []
    for payload in config.payloads():
        mass = f"{TruckParameters.load().gross_mass(payload) / 1e3:.0f} t"
        laden = payload > 0.5 * TruckParameters.load().payload.mass_max
        fast = 40.0 if laden else 75.0
        rides += [
            Ride(f"hills of 4 % at {fast:g} km/h, {mass}", hills(), payload, HILLS_LENGTH - 200.0,
                 fast * KMH),
            Ride(f"waves of 2 % at 85 km/h, {mass}", sloping(_WAVES_LENGTH, 0.0, _WAVES), payload,
                 _WAVES_LENGTH - 200.0, 85.0 * KMH),
            Ride(f"0 to 90 km/h and down to 20, {mass}", _level(), payload, 3_500.0, 90.0 * KMH,
                 _steps(), 0.0),
        ]  # fmt: skip
    return rides


def _level() -> Route:
    return Route.straight(length=4_000.0, speed_limit=_UNLIMITED)


def _steps() -> SpeedProfile:
    """30, 60 and 90 km/h, then down to 50 and 20."""
    station = np.array([0.0, 300.0, 301.0, 900.0, 901.0, 2500.0, 2600.0, 2900.0, 2950.0, 4000.0])
    speed = np.array([30.0, 30.0, 60.0, 60.0, 90.0, 90.0, 50.0, 50.0, 20.0, 20.0])
    return SpeedProfile(station, speed * KMH)


def _drive(ride: Ride, timestep: float) -> Record:
    start = ride.speed if ride.start_speed is None else ride.start_speed
    return drive(
        DriveTask(
            route=ride.route,
            start=_START,
            end=_START + ride.length,
            speed=start,
            cruise_speed=ride.speed,
            profile=ride.profile,
            payload=ride.payload,
            timestep=timestep,
            time_limit=600.0,
        )
    )


def _checks(ride: Ride, record: Record) -> list[Check]:
    error = tracking_error(record)
    return [
        Check(f"{ride.name}: speed error, rms", _rms(error), "m/s", 0.0, "<= 0.3"),
        Check(f"{ride.name}: speed error, greatest", float(np.abs(error).max()), "m/s", 0.0),
        Check(
            f"{ride.name}: pedal and brake take turns",
            reversals_per_km(record),
            "1/km",
            None,
            "<= 10",
        ),
        Check(
            f"{ride.name}: shortest time between turns",
            shortest_turn(record),
            "s",
            None,
            ">= 1",
        ),
    ]


def _hill_start(payload: float, timestep: float) -> list[Check]:
    """From standstill on 5 %: the way lost backwards, and the time to be under way."""
    name = f"start on 5 %, {TruckParameters.load().gross_mass(payload) / 1e3:.0f} t"
    route = Route.straight(length=1_000.0, grade=_STEEP, speed_limit=_UNLIMITED)
    task = DriveTask(route, _START, _START + 25.0, 0.0, 8.0, None, payload, timestep=timestep,
                time_limit=120.0)  # fmt: skip
    record = drive(task)
    under_way = int(np.argmax(record["speed"] >= _UNDER_WAY))
    back = float(record["station"][0] - record["station"].min())
    return [
        Check(f"{name}: rolled back", back, "m", 0.0, f"<= {_ROLL_BACK:g}"),
        Check(f"{name}: time to {_UNDER_WAY:g} m/s", float(record["time"][under_way]), "s"),
    ]


def _panels(record: Record) -> list[Panel]:
    part = slice(None, None, _PLOT_ROWS)
    station = record["station"][part]

    def line(label: str, column: str, scale: float = 1.0, role: str = "") -> Line:
        return Line(label, station, scale * record[column][part], role)

    place = "station [m]"
    return [
        Panel(
            "Speed",
            place,
            "speed [km/h]",
            (
                line("planned", "planned", 1.0 / KMH, "reference"),
                line("truck", "speed", 1.0 / KMH, "simulation"),
            ),
        ),
        Panel(
            "Who acts on it",
            place,
            "share [1]",
            (
                line("accelerator", "pedal"),
                line("engine brake", "engine_brake"),
                line("retarder", "retarder"),
                line("XBR demand [m/s2]", "xbr_demand"),
            ),
        ),
        Panel("Gear", place, "gear [-]", (line("gear", "gear"),)),
    ]


def _rms(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
