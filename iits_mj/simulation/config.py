"""Configurations of a drive and of a served truck, which are also the flags of the commands."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from controllers import own_parts
from controllers.decision.prices import PriceOptions
from controllers.protocols import (
    DecisionMaker,
    LateralControl,
    LongitudinalControl,
    SpeedSource,
    TrajectoryPlanner,
)
from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option, part_option, plant_option
from iits_mj.core.own_parts import part_name
from iits_mj.j1939.bus import REACHES
from iits_mj.j1939.network import CONTROLLER, LAST_ADDRESS
from iits_mj.parameters import AnyTruck, check_truck, payload_option, truck_option
from iits_mj.road.route_choice import route_option
from iits_mj.road.unevenness import CLASSES
from iits_mj.simulation.sensors import CHOICES as SENSORS
from traffic_bridge import TRAFFIC, TrafficSource
from traffic_bridge.config import HIGHEST_BICYCLE_SHARE, HIGHEST_HEAVY_SHARE, MOST_PEDESTRIANS
from traffic_bridge.scenario.parameters import assignments
from traffic_bridge.vehicles.service_level import BOUNDS

DENSITIES = ("dense", "medium", "sparse", "empty", *BOUNDS)
LANE_CHANGE_MODELS = ("lc2013", "mobil")
LANE_DISCIPLINES = ("right", "free")
KEEP_RIGHT = ("map", "on", "off")
TRAFFIC_SCOPES = ("route", "both", "map")
COMMAND_PATHS = ("direct", "j1939")
BUSES = ("virtual", "socketcan", "udp_multicast")
SILENCE = ("release", "stop")
# Start in traffic of a level of service on the built-in highway [m]: far enough from its beginning
# that traffic follows the truck, too.
LEVEL_START = 1_000.0
LEVEL_SPEED = 80.0 / 3.6  # [m/s] of the truck in such traffic: the limit for trucks on motorways
# The parts of a drive that a user may replace, by option.
PARTS = {
    "decision": own_parts.DECISION,
    "planner": own_parts.PLANNER,
    "lateral": own_parts.LATERAL,
    "longitudinal": own_parts.LONGITUDINAL,
    "speed_planner": own_parts.SPEED,
    "traffic_mode": TRAFFIC,
}


def _speed_option(
    default: float | None, help: str, group: str = "decision", low: float = 1.0
) -> Any:
    return option(default, help=help, unit="m/s", low=low, high=30.0, group=group)


@dataclass(frozen=True, kw_only=True)
class TruckStart:
    """Truck and start of a drive; every field is checked when an instance is made.

    Raises:
      InputError: a value is out of its bounds, unknown, or not finite, or the truck is not usable.
    """

    truck: AnyTruck | None = truck_option("truck to drive")
    map: Path | None = option(
        None,
        help="OpenDRIVE map (.xodr), OpenStreetMap extract (.osm) or SUMO net (.net.xml); without "
        "it the built-in 15 km highway",
        metavar="FILE.xodr",
        group="road",
    )
    route: str | None = route_option()
    payload: float | None = payload_option()
    payload_height: float | None = option(
        None,
        help="height of the load's center of gravity above the road; without it the truck's own",
        unit="m",
        low=0.0,
        group="truck",
    )
    plant: str = plant_option()
    start_station: float = option(
        60.0,
        help="station of the steer axle at the start; without it 60 m, or the first point of the "
        "route",
        unit="m",
        low=0.0,
        high=1e6,
        group="road",
    )
    start_lane: int = option(
        0,
        help="lane at the start; 0 is the lane nearest to the edge of the road: the rightmost one "
        "in right-hand traffic, the leftmost one in left-hand traffic",
        low=0,
        high=10,
        group="road",
    )
    start_speed: float = _speed_option(
        15.0,
        "speed at the start; reduced to the reference speed, to the speed limit, to the speed that "
        "the bends ahead allow, and to that of a level of service",
        "road",
        low=0.0,
    )

    roughness: str = option(
        "smooth",
        help="class of the road's roughness, ISO 8608; A: very good, D: poor",
        choices=tuple(CLASSES),
        group="road",
    )
    potholes: float = option(
        0.0, help="potholes per kilometer of lane", low=0.0, high=200.0, group="road"
    )
    joint_spacing: float | None = option(
        None,
        help="distance of expansion joints across the road; without it there are none",
        unit="m",
        low=2.0,
        high=1000.0,
        group="road",
    )
    cross_slope: float = option(
        0.0,
        help="fall of the road to its outer side, in addition to the map's superelevation",
        unit="%",
        low=-8.0,
        high=8.0,
        group="road",
    )
    road_seed: int = option(
        0,
        help="seed of the roughness and the potholes",
        low=0,
        high=2**31 - 1,
        group="road",
    )

    def __post_init__(self) -> None:
        options.check(self)
        check_truck(self).with_payload_height(self.payload_height)


@dataclass(frozen=True, kw_only=True)
class DriveConfig(PriceOptions, TruckStart):
    """A drive of the truck and its driving stack along a route in traffic.

    The options of `PARTS` also take the user's own class, function or object; see
    `iits_mj.core.own_parts`. An object serves one drive at a time.
    """

    density: str = option(
        "dense",
        help="amount of traffic; A to F: level of service of the Highway Capacity Manual, with "
        "headways and lane changes as on motorways, and without other options a truck at 80 km/h "
        "from station 1000 m on",
        choices=DENSITIES,
        group="traffic",
    )
    heavy_share: float | None = option(
        None,
        help="share of trucks in the traffic; without it 0.18",
        low=0.0,
        high=HIGHEST_HEAVY_SHARE,
        group="traffic",
    )
    traffic_speed: float | None = option(
        None,
        help="speed limit of the traffic; without it 12.5 m/s, or the road's limit with a level of "
        "service (36.1 m/s on a road without limit)",
        unit="m/s",
        low=3.0,
        high=40.0,
        group="traffic",
    )
    traffic_mode: str | type[TrafficSource] | TrafficSource = part_option(
        "inter",
        TRAFFIC,
        "inter: SUMO traffic that reacts to the truck; pure: SUMO traffic that does not see the "
        "truck; none: empty road, without SUMO and its net of the map",
        group="traffic",
    )
    lane_change: str = option(
        "lc2013",
        help="lane-change model of the traffic; lc2013: SUMO's default; mobil: MOBIL, by the "
        "acceleration gained",
        choices=LANE_CHANGE_MODELS,
        group="traffic",
    )
    lane_discipline: str = option(
        "right",
        help="lane use of the traffic; right: keeps right and overtakes on the left; free: fills "
        "all lanes, overtakes on both sides and never gives way",
        choices=LANE_DISCIPLINES,
        group="traffic",
    )
    traffic_scope: str = option(
        "route",
        help="roads with traffic; route: the truck's route; both: also the opposite lanes; map: "
        "all roads of the map",
        choices=TRAFFIC_SCOPES,
        group="traffic",
    )
    pedestrians: float = option(
        0.0,
        help="persons per hour at each crossing of the map, simulated by SUMO; the map needs "
        "sidewalks",
        unit="1/h",
        low=0.0,
        high=MOST_PEDESTRIANS,
        group="traffic",
    )
    bicycles: float = option(
        0.0,
        help="share of cyclists in the traffic; they ride on the driving lanes",
        low=0.0,
        high=HIGHEST_BICYCLE_SHARE,
        group="traffic",
    )
    events: Path | None = option(
        None,
        help="file of scripted events: vehicles that cut in or brake, pedestrians, friction, wind, "
        "faults, lights, closures and more",
        metavar="FILE.toml",
        group="traffic",
    )
    scenario: Path | None = option(
        None,
        help="OpenSCENARIO XML file: map, start and events of the drive; its ego is the truck; "
        "without SUMO traffic",
        metavar="FILE.xosc",
        group="traffic",
    )
    ego: str | None = option(
        None,
        help="entity of the scenario that is the truck; without it Ego or Hero",
        metavar="NAME",
        group="traffic",
    )
    param: tuple[str, ...] = option(
        (),
        help="value of a parameter of the events or the scenario; may be given for several "
        "parameters",
        test=assignments,
        metavar="NAME=VALUE",
        group="traffic",
    )
    recording: Path | None = option(
        None,
        help="drive in this recorded traffic, which does not react, instead of SUMO traffic",
        metavar="FILE.npz",
        group="traffic",
    )
    reactive: bool = option(
        False,
        help="add SUMO traffic to the recorded traffic; it reacts to the recorded vehicles and to "
        "the truck",
        group="traffic",
    )
    speed: float = _speed_option(60.0 / 3.6, "reference speed of the truck; 16.67 m/s is 60 km/h")
    speed_planner: str | type[SpeedSource] | SpeedSource = part_option(
        "pcc",
        own_parts.SPEED,
        "source of the planned speed; pcc: predictive cruise control, which saves fuel on hills in "
        "the trip time of a cruise; cruise: constant speed",
    )
    speed_min: float | None = _speed_option(
        None, "lowest speed that pcc plans on a free road; without it 0.75 of the reference speed"
    )
    speed_max: float | None = _speed_option(
        None,
        "highest speed that pcc plans within the road's limits; without it 25 m/s, the 90 km/h of "
        "a truck's speed limiter",
    )
    speed_profile: Path | None = option(
        None,
        help="follow this table of speed over station, written by 'iits-mj pcc --profile', instead "
        "of a planned speed",
        metavar="FILE.csv",
        group="decision",
    )
    decision: str | type[DecisionMaker] | DecisionMaker = part_option(
        "ddqn", own_parts.DECISION, "decision maker for lane changes"
    )
    keep_right: str = option(
        "map",
        help="on: the truck returns towards lane 0 when that lane stays free for 20 s, and "
        "passes only when its own lane does not; map: on motorways and rural roads of countries "
        "with this rule, where the map names the country",
        choices=KEEP_RIGHT,
        group="decision",
    )
    planner: str | type[TrajectoryPlanner] | TrajectoryPlanner = part_option(
        "paper", own_parts.PLANNER, "trajectory planner; paper: the paper's Algorithm 1"
    )
    lateral: str | type[LateralControl] | LateralControl = part_option(
        "preview", own_parts.LATERAL, "steering controller; preview: linear-quadratic, with preview"
    )
    longitudinal: str | type[LongitudinalControl] | LongitudinalControl = part_option(
        "inverse",
        own_parts.LONGITUDINAL,
        "speed controller; inverse: inverse powertrain and brake blending",
    )
    sensors: str = option(
        "perfect",
        help="what the driving stack knows of the traffic; perfect: everything at once; front: "
        "tracks of two radars and a camera at the front; surround: also of radars at both sides",
        choices=SENSORS,
        group="decision",
    )
    aeb: str = option(
        "off",
        help="advanced emergency braking, apart from the planner; on: it warns and brakes for "
        "vehicles ahead",
        choices=("off", "on"),
        group="decision",
    )
    commands: str = option(
        "direct",
        help="path of the commands to the truck; direct: unchanged; j1939: as frames at their "
        "rates, through the truck's receiver",
        choices=COMMAND_PATHS,
        group="decision",
    )
    duration: float = option(
        120.0, help="longest simulated time", unit="s", low=1.0, high=86_400.0, group="run"
    )
    seed: int = option(0, help="seed of everything random", low=0, high=2**31 - 1, group="run")

    @property
    def has_events(self) -> bool:
        """Whether a file of events or a scenario is played."""
        return self.events is not None or self.scenario is not None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ego is not None and self.scenario is None:
            raise InputError("ego names an entity of a scenario: give scenario, too")
        if self.param and not self.has_events:
            raise InputError("param sets a parameter of events or a scenario: give one of them")
        if self.prices() is not None and self.decision != "ddqn":
            maker = part_name(self.decision)
            raise InputError(f"lane-change-price is of decision ddqn; decision is {maker!r}")


AnyDrive = TypeVar("AnyDrive", bound=DriveConfig)


def with_level_start(config: AnyDrive, given: AbstractSet[str]) -> AnyDrive:
    """Returns the drive with the start that suits traffic of a level of service.

    The truck drives 80 km/h and starts at this speed (`Simulation` reduces it to the traffic's), on
    the built-in highway behind the first kilometer. Options that the user gave stay.

    Args:
      config: the drive; without a level of service it is returned unchanged.
      given: names of the options that the user gave.
    """
    if config.density not in BOUNDS:
        return config
    values: dict[str, Any] = {"speed": LEVEL_SPEED, "start_speed": LEVEL_SPEED}
    if config.map is None:
        values["start_station"] = LEVEL_START
    return replace(config, **{k: v for k, v in values.items() if k not in given})


@dataclass(frozen=True, kw_only=True)
class ServeConfig(TruckStart):
    """A truck that is driven over a CAN bus.

    Raises:
      InputError: a value is out of its bounds, unknown, or not finite.
    """

    bus: str = option(
        "udp_multicast",
        help="virtual: within this process; socketcan: a Linux CAN interface; udp_multicast: other "
        "processes and machines",
        choices=BUSES,
        group="bus",
    )
    channel: str | None = option(
        None,
        help="CAN interface (can0), or multicast group with or without port (239.74.163.2:43113)",
        metavar="NAME",
        group="bus",
    )
    reach: str = option(
        "host",
        help="machines that can drive the truck over udp_multicast; host: this one; network: every "
        "machine of the local network, without authentication",
        choices=REACHES,
        group="bus",
    )
    start_speed: float = _speed_option(
        0.0, "speed at the start; at 0 the parking brake holds until commands arrive", "road", 0.0
    )
    duration: float | None = option(
        None,
        help="time to serve; without it until Ctrl-C, SIGTERM, the end of the road or an accident",
        unit="s",
        low=0.1,
        high=1e7,
        group="run",
    )
    on_silence: str = option(
        "stop",
        help="behavior while commands are missing; release: release pedal and brakes, hold the "
        "steering; stop: brake smoothly to a stop in the lane and park",
        choices=SILENCE,
        group="bus",
    )
    source: int = option(
        CONTROLLER, help="address of the sender to obey", low=0, high=LAST_ADDRESS, group="bus"
    )
    any_source: bool = option(
        False,
        help="obey every address but the truck's own, each by the priority of its requests",
        group="bus",
    )
    can_log: Path | None = option(
        None,
        help="log of all frames sent and received; the suffix selects the format",
        metavar="FILE",
        group="output",
    )
