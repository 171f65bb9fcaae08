"""Configurations of a drive and of a served truck, which are also the flags of the commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from controllers import decision
from iits_mj.core import options
from iits_mj.core.options import option
from iits_mj.j1939.network import LAST_ADDRESS

DENSITIES = ("dense", "medium", "sparse", "empty")
TRAFFIC_MODES = ("inter", "pure", "none")
LANE_CHANGE_MODELS = ("lc2013", "mobil")
LANE_DISCIPLINES = ("right", "free")
TRAFFIC_SCOPES = ("route", "both", "map")
COMMAND_PATHS = ("direct", "j1939")
SPEED_PLANNERS = ("pcc", "cruise")
BUSES = ("virtual", "socketcan", "udp_multicast")
SILENCE = ("release", "stop")


@dataclass(frozen=True, kw_only=True)
class TruckStart:
    """Truck and start of a drive; every field is checked when an instance is made.

    Raises:
      InputError: a value is out of its bounds, unknown, or not finite.
    """

    map: Path | None = option(
        None, help="OpenDRIVE map; without it the built-in 15 km highway", metavar="FILE.xodr"
    )
    payload: float = option(
        36_000.0, help="load on the semitrailer", unit="kg", low=0.0, high=36_000.0, metavar="KG"
    )
    payload_height: float | None = option(
        None,
        help="height of the load's centre of gravity above the road; without it 2.23 m",
        unit="m",
        low=1.3,
        high=3.0,
        metavar="M",
    )
    start_station: float = option(
        60.0,
        help="start of the steer axle along the route",
        unit="m",
        low=0.0,
        high=1e6,
        metavar="M",
    )
    start_lane: int = option(0, help="lane to start in, 0 being the right one", low=0, high=10)
    start_speed: float = option(
        15.0,
        help="speed to start with, at most the reference, the limit there and the greatest speed "
        "for the bends ahead",
        unit="m/s",
        low=0.0,
        high=30.0,
        metavar="MPS",
    )

    def __post_init__(self) -> None:
        options.check(self)


@dataclass(frozen=True, kw_only=True)
class DriveConfig(TruckStart):
    """A drive of the truck with its stack over a route in traffic."""

    density: str = option("dense", help="amount of traffic", choices=DENSITIES)
    traffic_speed: float = option(
        12.5, help="speed limit of the traffic", unit="m/s", low=3.0, high=40.0, metavar="MPS"
    )
    traffic_mode: str = option(
        "inter",
        help="inter: SUMO traffic that reacts to the truck; pure: SUMO traffic that does not see "
        "it; none: an empty road, without SUMO",
        choices=TRAFFIC_MODES,
    )
    lane_change: str = option(
        "lc2013",
        help="how the traffic changes lanes; lc2013: SUMO's model; mobil: by acceleration gained",
        choices=LANE_CHANGE_MODELS,
    )
    lane_discipline: str = option(
        "right",
        help="lanes that the traffic fills; right: it keeps right and overtakes on the left; "
        "free: it fills all lanes, overtakes on both sides and never gives way",
        choices=LANE_DISCIPLINES,
    )
    traffic_scope: str = option(
        "route",
        help="where the traffic drives; route: along the truck's route; both: on the opposite "
        "lanes too; map: on all roads of the map",
        choices=TRAFFIC_SCOPES,
    )
    events: Path | None = option(
        None,
        help="events in the traffic: lights, limits, closures, stopped vehicles, convoys",
        metavar="FILE.toml",
    )
    recording: Path | None = option(
        None,
        help="recorded traffic in place of SUMO; it does not react",
        metavar="FILE.npz",
    )
    reactive: bool = option(
        False, help="also SUMO traffic around the recorded one, which reacts to it and the truck"
    )
    speed: float = option(
        60.0 / 3.6,
        help="reference speed of the truck, 16.67 m/s being 60 km/h",
        unit="m/s",
        low=1.0,
        high=30.0,
        metavar="MPS",
    )
    speed_planner: str = option(
        "pcc",
        help="source of the planned speed; pcc: predictive cruise control, which saves fuel on "
        "hills in the trip time of a cruise; cruise: constant speed",
        choices=SPEED_PLANNERS,
    )
    speed_min: float | None = option(
        None,
        help="least speed that pcc plans on a free road; without it 0.75 of the reference speed",
        unit="m/s",
        low=1.0,
        high=30.0,
        metavar="MPS",
    )
    speed_max: float | None = option(
        None,
        help="greatest speed that pcc plans within the road's limits; without it 25 m/s, the "
        "90 km/h of a truck's limiter",
        unit="m/s",
        low=1.0,
        high=30.0,
        metavar="MPS",
    )
    speed_profile: Path | None = option(
        None,
        help="speed over station to drive instead, a table written by pcc --profile",
        metavar="FILE.csv",
    )
    decision: str = option("ddqn", help="decision maker for lane changes", choices=decision.NAMES)
    commands: str = option(
        "direct",
        help="how commands reach the truck; direct: as they are; j1939: as frames at their rates, "
        "through the truck's receiver",
        choices=COMMAND_PATHS,
    )
    duration: float = option(
        120.0, help="time to drive", unit="s", low=1.0, high=86_400.0, metavar="S"
    )
    seed: int = option(0, help="the one seed of everything random", low=0, high=2**31 - 1)


@dataclass(frozen=True, kw_only=True)
class ServeConfig(TruckStart):
    """A truck that is driven over a CAN bus.

    Raises:
      InputError: a value is out of its bounds, unknown, or not finite.
    """

    bus: str = option(
        "udp_multicast",
        help="virtual: within this process only; socketcan: a Linux CAN interface; udp_multicast: "
        "other processes and machines",
        choices=BUSES,
    )
    channel: str | None = option(
        None,
        help="CAN interface (can0), or multicast group with or without port (239.74.163.2:43113)",
        metavar="NAME",
    )
    start_speed: float = option(
        0.0,
        help="speed to start with; at 0 the parking brake holds until commands arrive",
        unit="m/s",
        low=0.0,
        high=30.0,
        metavar="MPS",
    )
    duration: float | None = option(
        None,
        help="time to serve; without it until Ctrl-C, SIGTERM, the end of the road or an accident",
        unit="s",
        low=0.1,
        high=1e7,
        metavar="S",
    )
    on_silence: str = option(
        "release",
        help="when commands are missing; release: let go of pedal and brakes, hold the steering; "
        "stop: brake smoothly to a stop in the lane and park",
        choices=SILENCE,
    )
    source: int | None = option(
        None,
        help="obey this sender only; without it every address but the truck's own",
        low=0,
        high=LAST_ADDRESS,
        metavar="ADDRESS",
    )
    can_log: Path | None = option(
        None, help="log of the bus, both ways; the suffix picks the format", metavar="FILE"
    )
