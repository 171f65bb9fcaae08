"""Energy audit over a hilly trip: nothing is made, and every joule of the engine is found.

    engine work = kinetic + potential + springs and tires + air + rolling + tire slip + dampers
                  + brakes + retarder + driveline's losses and store

The engine's side and the brakes' work are the plugin's own counters, the rest is summed up by
`energy.Ledger`, which also says what the brakes must have taken by the moments on the wheels. The
truck starts at rest, keeps 70 km/h over hills as far as it can, brakes for a slow stretch (in the
whole trip in the middle of a descent), and drives on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.results import Check, Line, Panel
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.energy import Ledger, Losses, Stored
from iits_mj.validation.recorder import PERIOD
from iits_mj.validation.slopes import HILLS_LENGTH, hills
from iits_mj.validation.speed_keeper import SpeedKeeper

_START, _END_MARGIN = 30.0, 60.0
_CRUISE, _SLOW = 70.0 * KMH, 35.0 * KMH
# Where the truck has to be slow, over the length of the trip.
_SLOW_FROM, _SLOW_TO = 0.6, 0.65
_TIME_LIMIT = 400.0
_CLOSED = 0.5
_COUNTERS = ("engine_work", "driveline_loss", "retarder_work", "driveline_energy", "brake_work")


@dataclass(frozen=True)
class Trip:
    """What a trip took [J]: by the ledger, by what is stored more than before, and by counters.

    Attributes:
      losses: sums of the ledger; before, after: what the truck stored.
      counters: change of each of the plugin's counters, nan where the model has none of the name.
      time, way: history of time [s] and position [m], shape (n,).
      history: sums of the ledger at these times, shape (n, k).
    """

    losses: Losses
    before: Stored
    after: Stored
    counters: dict[str, float]
    time: np.ndarray
    way: np.ndarray
    history: np.ndarray

    @property
    def stored(self) -> float:
        """Gain of everything stored on the wheels' side of the propeller shaft [J]."""
        return self.after.total - self.before.total

    @property
    def dissipated(self) -> float:
        """Losses on the wheels' side of the propeller shaft [J]."""
        found = self.losses
        road = found.air + found.rolling + found.slip
        brakes = self.counters["brake_work"]
        return road + found.tire_damping + found.suspension + brakes

    @property
    def wheels_error(self) -> float:
        """Energy that the propeller shaft gave and nobody got, over its work [1]."""
        return (self.losses.shaft - self.stored - self.dissipated) / self.losses.shaft

    @property
    def driveline_error(self) -> float:
        """Engine work that neither reached the shaft nor was counted, over engine work [1]."""
        c = self.counters
        engine = c["engine_work"] - c["driveline_loss"] - c["driveline_energy"] - c["retarder_work"]
        return (engine - self.losses.shaft) / c["engine_work"]

    @property
    def error(self) -> float:
        """Engine work that is nowhere, over engine work [1]."""
        c = self.counters
        found = self.stored + self.dissipated
        found += c["driveline_loss"] + c["driveline_energy"] + c["retarder_work"]
        return (c["engine_work"] - found) / c["engine_work"]


def drive(payload: float, timestep: float, length: float = HILLS_LENGTH) -> Trip:
    """The trip with this payload [kg], over the first `length` m of the hills."""
    truck = Truck.load(payload, route=hills(), timestep=timestep, visuals=False)
    truck.reset(station=_START)
    truck.step(round(1.0 / timestep))
    ledger, keeper = Ledger(truck), SpeedKeeper()
    before, counters = ledger.stored(), _counters(truck)
    steps = round(PERIOD / timestep)
    rows = []
    way = _START
    begin = truck.time
    while way < length - _END_MARGIN and truck.time - begin < _TIME_LIMIT:
        way = float(truck.data.qpos[0])
        target = _SLOW if _SLOW_FROM < way / length < _SLOW_TO else _CRUISE
        truck.command(keeper.command(float(truck.data.qvel[0]), target))
        ledger.step(steps)
        rows.append([truck.time - begin, way, *vars(ledger.losses).values()])
    after = ledger.stored()
    table = np.array(rows)
    return Trip(
        losses=ledger.losses,
        before=before,
        after=after,
        counters={name: value - counters[name] for name, value in _counters(truck).items()},
        time=table[:, 0],
        way=table[:, 1],
        history=table[:, 2:],
    )


def compare(payload: float, timestep: float, length: float) -> tuple[list[Check], list[Panel]]:
    """The audit as checks, each share over the engine's work."""
    trip = drive(payload, timestep, length)
    label = f"energy audit, {payload / 1e3:g} t load, {trip.way[-1] - trip.way[0]:.0f} m of hills"
    work = trip.counters["engine_work"]
    parts = {
        "kinetic": trip.after.kinetic - trip.before.kinetic,
        "potential": trip.after.potential - trip.before.potential,
        "springs and tires": trip.stored
        - (trip.after.kinetic + trip.after.potential)
        + (trip.before.kinetic + trip.before.potential),
        "air": trip.losses.air,
        "rolling": trip.losses.rolling,
        "tire slip": trip.losses.slip,
        "dampers": trip.losses.tire_damping + trip.losses.suspension,
        "brakes": trip.counters["brake_work"],
        "retarder": trip.counters["retarder_work"],
        "driveline": trip.counters["driveline_loss"],
        "driveline, stored": trip.counters["driveline_energy"],
    }
    brakes = 100.0 * (trip.counters["brake_work"] - trip.losses.brakes) / work
    checks = [
        Check(f"{label}: engine work", work / 1e6, "MJ"),
        *[
            Check(f"{label}: {name}, of the engine's work", 100.0 * part / work, "%")
            for name, part in parts.items()
        ],
        _closed(f"{label}: missing, in all", 100.0 * trip.error),
        _closed(f"{label}: missing between engine and shaft", 100.0 * trip.driveline_error),
        _closed(f"{label}: missing between shaft and road", 100.0 * trip.wheels_error),
        _closed(f"{label}: brake work of the sensor against the wheels' moments", brakes),
    ]
    history = dict(zip(vars(trip.losses), trip.history.T / 1e6, strict=True))
    shown = {name: history[name] for name in ("air", "rolling", "slip", "brakes")}
    shown["dampers"] = history["tire_damping"] + history["suspension"]
    lines = (
        Line("work of the propeller shaft", trip.way, history["shaft"], "reference"),
        *(Line(name, trip.way, values) for name, values in shown.items()),
    )
    return checks, [Panel(f"{label}: sums", "way [m]", "energy [MJ]", lines)]


def _closed(name: str, value: float) -> Check:
    return Check(name, value, "%", None, f"{-_CLOSED:g} .. {_CLOSED:g}")


def _counters(truck: Truck) -> dict[str, float]:
    known = {truck.model.sensor(i).name for i in range(truck.model.nsensor)}
    return {name: truck.read(name) if name in known else float("nan") for name in _COUNTERS}
