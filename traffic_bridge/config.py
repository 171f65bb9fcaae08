"""Settings of a traffic simulation, checked when they are made."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from iits_mj.core.assets import DEFAULT_MIX
from iits_mj.core.boxes import UnitShape
from iits_mj.core.checks import in_range, is_number, is_whole, make_plain, shown
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from traffic_bridge.scenario.actions import CrossRoad, PlaceVehicle, Swarm
from traffic_bridge.scenario.reading import check_references, event_of
from traffic_bridge.signals.events import Event, SlowConvoy, StoppedVehicle, VehicleChange
from traffic_bridge.vehicles.service_level import BOUNDS, SteadyFlow, steady_flow
from traffic_bridge.vehicles.types import (
    FASTEST,
    ROAD_USERS,
    VehicleType,
    default_types,
    motorway_types,
    road_user_types,
    type_from_dict,
)

# Spawn probability per second and lane of the paper's three densities (section VI-C).
DENSITIES = {"dense": 0.05, "medium": 0.02, "sparse": 0.005, "empty": 0.0}
LANE_CHANGE_MODELS = ("lc2013", "mobil")
LANE_DISCIPLINES = ("right", "free")
HIGHEST_HEAVY_SHARE = 0.6
HIGHEST_BICYCLE_SHARE = 0.5
BICYCLE = "bicycle"
SCOPES = ("route", "both", "map")
MOST_PEDESTRIANS = 3_000.0  # per hour at a crossing of 4 m: a person each 1.2 s
# Allowed values of the numbers in `TrafficConfig`.
RANGES = {
    "speed_limit": (1.0, FASTEST),
    "view_range": (10.0, 5_000.0),
    "step_length": (0.01, 1.0),
    "lane_change_duration": (0.0, 10.0),
    "clear_distance": (20.0, 5_000.0),
    "fill_ahead": (0.0, 200_000.0),
    "fill_behind": (0.0, 200_000.0),
    "pedestrians": (0.0, MOST_PEDESTRIANS),
    "bicycles": (0.0, HIGHEST_BICYCLE_SHARE),
}


@dataclass(frozen=True)
class Departure:
    """One listed vehicle, which departs at `time` or as soon afterwards as its place is free.

    Attributes:
      time: traffic time [s].
      type: name of its type.
      lane: of the route, from the outside.
      station: of its front bumper [m]; None: the beginning of the route.
      speed: desired speed [m/s]; None: the mean of its type.

    Raises:
      InputError: a value is not allowed.
    """

    time: float
    type: str = "car"
    lane: int = 0
    station: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        """Checks every value."""
        in_range("departure: time", self.time, 0.0, 1e6)
        if not isinstance(self.type, str) or not self.type:
            raise InputError(f"departure: type = {self.type!r}: must be the name of a vehicle type")
        if not is_whole(self.lane) or self.lane < 0:
            raise InputError(f"departure: lane = {self.lane!r}: must be a whole number from 0 on")
        if self.station is not None:
            in_range("departure: station", self.station, 0.0, 1e6)
        if self.speed is not None:
            in_range("departure: speed", self.speed, 0.5, FASTEST)
        make_plain(self)


@dataclass(frozen=True)
class TrafficConfig:
    """Settings of PureSim and InterSim.

    Attributes:
      density: "dense", "medium", "sparse", "empty", or the spawn probability per second and lane,
        0 to 0.5. It also sets the number of vehicles on the road at the beginning. A mapping gives
        each type its own probability and replaces `mix`. Or a level of service, "A" to "F", whose
        density the traffic gets (`traffic_bridge.vehicles.service_level`).
      speed_limit: maximum speed of the traffic [m/s]; every vehicle's desired speed is a fraction
        of it (see `VehicleType`). The paper uses 12.5 and 15.
      lane_change: "lc2013" (SUMO's model) or "mobil" (see `traffic_bridge.vehicles.mobil`).
      lane_discipline: "right": vehicles keep right as their types define; "free": they do not keep
        right, do not give way to faster followers and stay in their lane after overtaking, so that
        all lanes fill equally (`keep_right_bias`, `politeness` and `lc_keep_right` of all types are
        zero).
      mix: name and weight of each type of vehicle that departs at random.
      heavy_share: share of trucks in the mix, 0 to 0.6; None: as in `mix`.
      types: the `VehicleType`s, each with a unique name; None: `motorway_types()` for a level of
        service, else `default_types()`.
      view_range: vehicles within this distance of the ego are reported [m].
      step_length: [s].
      lane_change_duration: duration of the sideways motion of a lane change [s]; 0 shows SUMO's
        instantaneous change.
      clear_distance: no vehicle appears within this distance of the ego [m].
      fill_ahead, fill_behind: lengths of road ahead of and behind the ego that are populated at
        the beginning [m].
      scope: roads with traffic: "route": along the ego's route; "both": also on the opposite lanes
        of its roads; "map": on all roads of the map, with turns at junctions; vehicles enter and
        leave at the map's ends, and out of sight of the truck where the density needs it.
      turning_shares: of vehicles that turn right, go straight and turn left at a junction, for each
        lane that makes the turn; only for the scope "map".
      pedestrians: persons per hour at each crossing of the map; it needs sidewalks, see
        `traffic_bridge.vehicles.pedestrians`.
      bicycles: share of cyclists in the mix, 0 to 0.5; they ride on the driving lanes.
      footprint: size of the ego combination.
      units: its units from above, off which pedestrians keep; (): one stiff body of the footprint.
      events: see `traffic_bridge.signals.events` and `traffic_bridge.scenario.actions`.
      departures: listed vehicles, in addition to the random ones.

    Raises:
      InputError: a value is out of its range; the message names what is allowed.
    """

    density: str | float | Mapping[str, float] = "medium"
    speed_limit: float = 15.0
    lane_change: str = "lc2013"
    lane_discipline: str = "right"
    mix: tuple[tuple[str, float], ...] = DEFAULT_MIX
    heavy_share: float | None = None
    types: tuple[VehicleType, ...] = None  # type: ignore[assignment]
    view_range: float = 400.0
    step_length: float = 0.1
    lane_change_duration: float = 3.5
    clear_distance: float = 150.0
    fill_ahead: float = 15_000.0
    fill_behind: float = 2_000.0
    scope: str = "route"
    turning_shares: tuple[float, float, float] = (0.3, 0.5, 0.2)  # default of SUMO's jtrrouter
    footprint: EgoFootprint = field(default_factory=EgoFootprint)
    units: tuple[UnitShape, ...] = ()
    events: tuple[Event, ...] = ()
    departures: tuple[Departure, ...] = ()
    pedestrians: float = 0.0
    bicycles: float = 0.0

    def __post_init__(self) -> None:
        """Checks every value; converts mappings in `mix` and `density` to tuples and numbers."""
        if isinstance(self.density, Mapping):
            object.__setattr__(self, "mix", tuple(self.density.items()))
            for name, share in self.mix:
                in_range(f"density of {name}", share, 0.0, 0.5)
            object.__setattr__(self, "density", float(sum(share for _, share in self.mix)))
        if isinstance(self.mix, Mapping):
            object.__setattr__(self, "mix", tuple(self.mix.items()))
        if not _are_pairs(self.mix):
            raise InputError(f"mix {shown(self.mix)}: must be names of types with their weights")
        if not isinstance(self.density, str):
            in_range("density", self.density, 0.0, 0.5)
        elif self.density not in DENSITIES and self.density not in BOUNDS:
            raise InputError(
                f"density {shown(self.density)}: allowed are {', '.join(DENSITIES)}, a level of "
                f"service {', '.join(BOUNDS)}, "
                "or a probability from 0 to 0.5 per second and lane"
            )
        if self.types is None:
            types = default_types() if self.level is None else motorway_types()
            object.__setattr__(self, "types", types)
        for name, allowed in (
            ("lane_change", LANE_CHANGE_MODELS),
            ("lane_discipline", LANE_DISCIPLINES),
            ("scope", SCOPES),
        ):
            if getattr(self, name) not in allowed:
                raise InputError(
                    f"{name} {shown(getattr(self, name))}: allowed are {', '.join(allowed)}"
                )
        for name, (low, high) in RANGES.items():
            in_range(name, getattr(self, name), low, high)
        shares = self.turning_shares
        if not isinstance(shares, (tuple, list)) or len(shares) != 3:
            raise InputError(f"turning_shares {shown(shares)}: must be right, straight and left")
        for share in shares:
            in_range("turning_shares", share, 0.0, 1.0)
        if not any(share > 0.0 for share in shares):
            raise InputError(f"turning_shares {shown(shares)}: at least one must be positive")
        object.__setattr__(self, "turning_shares", tuple(shares))
        if not isinstance(self.footprint, EgoFootprint):
            raise InputError(f"footprint {shown(self.footprint)}: must be an EgoFootprint")
        for what, kind in (("types", VehicleType), ("events", Event), ("departures", Departure)):
            object.__setattr__(self, what, _all_of(what, getattr(self, what), kind))
        if self.bicycles and BICYCLE not in [kind.name for kind in self.types]:
            cyclist = next(kind for kind in road_user_types() if kind.name == BICYCLE)
            object.__setattr__(self, "types", (*self.types, cyclist))
        if self.lane_discipline == "free":
            kinds = tuple(
                dataclasses.replace(kind, keep_right_bias=0.0, politeness=0.0, lc_keep_right=0.0)
                for kind in self.types
            )
            object.__setattr__(self, "types", kinds)
        check_references(self.events)
        self._check_names({vehicle_type.name for vehicle_type in self.types})
        if self.heavy_share is not None:
            in_range("heavy_share", self.heavy_share, 0.0, HIGHEST_HEAVY_SHARE)
            self._mix_with(float(self.heavy_share))
        make_plain(self)
        self._check_units()

    def _check_units(self) -> None:
        """Checks the units of the truck, and keeps them as `UnitShape`s."""
        try:
            units = tuple(UnitShape(*unit) for unit in self.units)
        except TypeError:
            raise InputError(f"units {shown(self.units)}: must be UnitShapes") from None
        for unit in units:
            for name, size in unit._asdict().items():
                in_range(f"units: {name}", size, -100.0, 100.0, "m")
        object.__setattr__(self, "units", units)

    def _mix_with(self, heavy_share: float) -> tuple[tuple[str, float], ...]:
        """The mix with another share of heavy vehicles."""
        heavy = {kind.name for kind in self.types if kind.heavy}
        total = {
            flag: sum(weight for name, weight in self.mix if (name in heavy) == flag)
            for flag in (False, True)
        }
        wanted = {True: heavy_share, False: 1.0 - heavy_share}
        for flag, share in wanted.items():
            if share > 0.0 and total[flag] == 0.0:
                lacking = "heavy" if flag else "light"
                raise InputError(
                    f"heavy_share = {heavy_share:g}: the mix has no {lacking} vehicles"
                )
        factor = {flag: share / total[flag] if share else 0.0 for flag, share in wanted.items()}
        new = ((name, weight * factor[name in heavy]) for name, weight in self.mix)
        return tuple((name, weight) for name, weight in new if weight > 0.0)

    def _check_names(self, names: set[str]) -> None:
        """Checks that type names are unique, and that mix, events and departures use them."""
        known = ", ".join(kind.name for kind in self.types)
        if not self.types or len(names) != len(self.types):
            raise InputError(f"types {known!r}: at least one, each with a name of its own")
        if not self.mix or any(name not in names for name, _ in self.mix):
            raise InputError(f"mix {self.mix!r}: the kinds are {known}")
        weights = [weight for _, weight in self.mix]
        if any(not is_number(w) or w < 0.0 for w in weights) or not 0.0 < sum(weights) < math.inf:
            raise InputError(
                f"mix {shown(self.mix)}: weights are zero or positive, one at least positive"
            )
        for entry in (*self.events, *self.departures):
            wanted = None
            if isinstance(entry, (PlaceVehicle, CrossRoad)):
                if entry.type not in (*names, *ROAD_USERS):
                    raise InputError(
                        f"{entry.kind}: type = {entry.type!r}: the types are {known}, "
                        f"{', '.join(ROAD_USERS)}"
                    )
            elif isinstance(entry, Swarm):
                for wanted in entry.mix or ():
                    if wanted not in names:
                        raise InputError(f"{entry.kind}: mix: {wanted!r}: the types are {known}")
                wanted = None
            elif isinstance(entry, (StoppedVehicle, SlowConvoy, Departure)):
                wanted = entry.type
            elif isinstance(entry, VehicleChange) and "." not in entry.target:
                wanted = entry.target
            if wanted is not None and wanted not in names:
                raise InputError(f"{entry!r}: the types are {known}")

    @property
    def level(self) -> str | None:
        """The level of service, "A" to "F"; None if the density is given otherwise."""
        return self.density if isinstance(self.density, str) and self.density in BOUNDS else None

    @property
    def weights(self) -> tuple[tuple[str, float], ...]:
        """Name and weight of each type: `mix` with the `heavy_share` and the bicycles."""
        mix = self.mix if self.heavy_share is None else self._mix_with(self.heavy_share)
        if not self.bicycles:
            return mix
        share = self.bicycles / (1.0 - self.bicycles) * sum(weight for _, weight in mix)
        return (*mix, (BICYCLE, share))

    @property
    def shares(self) -> tuple[tuple[VehicleType, float], ...]:
        """The types of the mix with their shares, whose sum is 1."""
        total = sum(weight for _, weight in self.weights)
        return tuple((self.type_of(name), weight / total) for name, weight in self.weights)

    @property
    def steady(self) -> SteadyFlow | None:
        """Density, flow and speed of the level of service; None without one."""
        return (
            None if self.level is None else steady_flow(self.level, self.shares, self.speed_limit)
        )

    @property
    def probability(self) -> float:
        """Spawn probability per second and lane."""
        if (steady := self.steady) is not None:
            return steady.flow
        if isinstance(self.density, str):
            return DENSITIES[self.density]
        return float(self.density)  # type: ignore[arg-type]

    @property
    def oncoming(self) -> bool:
        """Whether traffic also drives on the opposite lanes of the route's roads."""
        return self.scope != "route"

    def type_of(self, name: str) -> VehicleType:
        """The vehicle type of a name; InputError if there is none."""
        for vehicle_type in self.types:
            if vehicle_type.name == name:
                return vehicle_type
        known = ", ".join(vehicle_type.name for vehicle_type in self.types)
        raise InputError(f"vehicle type {name!r}: allowed are {known}")

    def as_dict(self) -> dict[str, Any]:
        """The settings as values for a JSON file; `from_dict` is the inverse."""
        return dataclasses.asdict(self) | {"events": [event.as_dict() for event in self.events]}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrafficConfig:
        """The configuration that `as_dict` wrote.

        Raises:
          InputError: a key is missing, unknown or has an unusable value.
        """
        try:
            given = dict(values)
            if "oncoming" in given:  # recordings of version 0.1
                given["scope"] = "both" if given.pop("oncoming") else "route"
            given["types"] = tuple(type_from_dict(entry) for entry in given["types"])
            given["mix"] = tuple((str(kind), float(weight)) for kind, weight in given["mix"])
            given["footprint"] = EgoFootprint(**given["footprint"])
            given["events"] = tuple(event_of(entry) for entry in given.get("events", ()))
            given["departures"] = tuple(Departure(**entry) for entry in given.get("departures", ()))
            return cls(**given)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"stored traffic configuration is not usable: {error}") from error


def _are_pairs(mix: Any) -> bool:
    return isinstance(mix, (tuple, list)) and all(
        isinstance(entry, (tuple, list)) and len(entry) == 2 and isinstance(entry[0], str)
        for entry in mix
    )


def _all_of(what: str, entries: Any, kind: type) -> tuple[Any, ...]:
    """The entries as a tuple; InputError if they are no sequence or one has another class."""
    if isinstance(entries, (str, kind)) or not isinstance(entries, Iterable):
        raise InputError(f"{what} {shown(entries)}: must be a sequence of {kind.__name__}")
    for entry in (made := tuple(entries)):
        if not isinstance(entry, kind):
            raise InputError(f"{what}: {shown(entry)} is no {kind.__name__}")
    return made
