"""Makes the map, the traffic and the driving stack of a simulation from its configuration."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import mujoco
import numpy as np

from controllers import decision
from controllers.own_parts import LATERAL, LONGITUDINAL, PLANNER, SPEED, guarded_speed
from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_reference import (
    CruiseReference,
    ProfileReference,
    SpeedReference,
    check_covers,
    read_profile,
)
from controllers.stack import Stack
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.core.options import given_in
from iits_mj.core.progress import remark, task
from iits_mj.core.timing import TIMESTEP
from iits_mj.model.scenery.road_scene import add_paint
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.route import USABLE_LANE_WIDTH
from iits_mj.road.unevenness import Unevenness
from iits_mj.road.xml_input import SIZE_LIMIT
from iits_mj.simulation.config import AnyDrive, DriveConfig, TruckStart
from iits_mj.simulation.frame import END_MARGIN, LEAVE_MARGIN
from iits_mj.truck import Truck
from traffic_bridge import (
    TRAFFIC,
    EventSim,
    InterSim,
    Mirror,
    MixedSim,
    OwnTraffic,
    PureSim,
    Recorder,
    RepSim,
    Traffic,
    TrafficConfig,
    read_events,
)
from traffic_bridge.mirror.mirror import CROWD, ROAD_USER_POOL
from traffic_bridge.network.map_sources import read_map
from traffic_bridge.network.markings import net_markings
from traffic_bridge.scenario.openscenario import OpenScenario, read_scenario
from traffic_bridge.scenario.openscenario_parameters import declared_parameters
from traffic_bridge.scenario.parameters import assignments
from traffic_bridge.scenario.reading import read_parameters
from traffic_bridge.signals.events import Event
from traffic_bridge.vehicles.service_level import BOUNDS

if TYPE_CHECKING:
    from controllers.pcc import PccConfig

_LARGE_MAP = 4 * 2**20  # bytes that take seconds to read
SPEED_LIMITER = 25.0  # [m/s]: 90 km/h, directive 92/6/EEC
FASTEST_START, SLOWEST_REFERENCE = 30.0, 1.0  # [m/s] of a start and of a reference speed
SLOWEST_SHARE = 0.75  # of the reference speed: a slower truck would obstruct the traffic
PAPER_TRAFFIC_SPEED = 12.5  # [m/s] speed limit of the traffic without a level of service
# [m/s] of traffic where a road has no limit: 130 km/h, as advised in Germany
UNLIMITED_SPEED = 36.1
LIMIT_SAMPLES = 200  # places where the route's limit is read
# Least road between the start and the end of the drive [m]; also on a short route.
_ROOM, _SHORTEST = 10.0, 1.0
_LAST: dict[str, Any] = {}  # the scenario that was read last
Start = TypeVar("Start", bound=TruckStart)


def placed(start: Start, route: Route, footprint: EgoFootprint) -> Start:
    """Returns the configuration with a start that fits the route.

    On a route that is too short for the default station the drive starts as early as possible. If
    the route is hardly longer than the truck, or the start is given so, the trailer starts before
    the route, where its plane continues.

    Raises:
      InputError: the start is not on the route, its lane does not exist there, or the route is too
        short; the message has the allowed values.
    """
    first, last = footprint.length, route.length - END_MARGIN - _ROOM
    earliest = footprint.length - footprint.front_overhang - LEAVE_MARGIN + _SHORTEST
    if last < first:
        first = earliest
        last = route.length - END_MARGIN - footprint.front_overhang - _SHORTEST
    if last < first:
        raise InputError(
            f"the route is {route.length:.1f} m long; the truck of {footprint.length:g} m needs "
            f"{route.length + first - last:.1f} m or more: choose another route or map"
        )
    station = start.start_station
    if station == TruckStart.start_station:
        wanted = station if route.start is None else route.start
        station = wanted if first <= wanted <= last else first
        if wanted > last and route.start is not None:
            station = last
        if station != wanted:
            remark(
                f"the route is {route.length:.0f} m long: the start is at station {station:.1f} m"
            )
        start = dataclasses.replace(start, start_station=station)
    if not earliest <= station <= last:
        raise InputError(
            f"start-station {station:g} m is not on the route; use "
            f"{math.ceil(earliest)} to {last:.0f} m of its {route.length:.0f} m"
        )
    lanes = route.lane_count(station)
    if not 0 <= start.start_lane < lanes:
        raise InputError(
            f"start-lane {start.start_lane} does not exist at station "
            f"{station:g} m; use 0 to {lanes - 1}"
        )
    if not route.lane_exists(start.start_lane, station):
        width = float(route.lane_width(start.start_lane, station))
        raise InputError(
            f"lane {start.start_lane} is {width:.2g} m "
            f"wide at station {station:g} m; vehicles use lanes of {USABLE_LANE_WIDTH:g} m or more"
        )
    return start


def with_scenario(config: AnyDrive) -> AnyDrive:
    """Returns the drive with map, route and start of its scenario; other drives are unchanged.

    Options stay that the user gave or that differ from their defaults. Applied again, it changes
    nothing.

    Raises:
      InputError: the scenario cannot be used; the message has its file and line. MapError: so the
        map.
    """
    if config.scenario is None:
        return config
    given = given_in(config)
    mode = config.traffic_mode
    if mode != "none" and (mode != "inter" or "traffic_mode" in given):
        raise InputError(
            f"traffic-mode = {mode!r}: a scenario has its own road users; leave traffic-mode out "
            "or give none"
        )
    if config.reactive:
        raise InputError("reactive is of SUMO traffic, which a scenario has not: leave it out")
    scenario = _read_scenario(config, config.scenario)
    asked = config
    config = dataclasses.replace(
        config,
        map=config.map or scenario.map,
        route=config.route or scenario.route,
        traffic_mode="none",
    )
    try:
        route = load_map(config.map).route(along=config.route)
    except InputError as error:
        raise InputError(f"{config.scenario}: road of {scenario.ego}: {error}") from None
    start = scenario.start(route, TruckParameters.load(config.truck).footprint)
    values: dict[str, Any] = {
        "start_station": start.station,
        "start_lane": start.lane,
        "start_speed": min(start.speed, FASTEST_START),
        "speed": min(max(start.speed, SLOWEST_REFERENCE), FASTEST_START),
    }
    fields = {field.name: field.default for field in dataclasses.fields(config)}
    set_here = {
        name: value
        for name, value in values.items()
        if name not in given and getattr(config, name) == fields[name]
    }
    config = dataclasses.replace(config, **set_here)
    if config != asked:
        for note in scenario.notes:
            remark(f"{config.scenario}: {note}")
    return config


def _read_scenario(config: DriveConfig, path: Path) -> OpenScenario:
    """Returns the scenario with the values of its parameters; those of a file of events are left.

    Without a file of events all parameters must be the scenario's. The last one is kept while its
    files stay as they are: a drive needs it several times.
    """
    given = assignments(config.param)
    if config.events is not None:
        own = declared_parameters(path)
        given = {name: text for name, text in given.items() if name in own}
    key = Path(path).absolute(), config.ego, tuple(sorted(given.items()))
    if _LAST.get("key") != key or _LAST["stamps"] != _stamps(path, *_LAST["scenario"].files):
        stamps = _stamps(path)
        scenario = read_scenario(path, config.ego, given)
        stamps += _stamps(*scenario.files)
        _LAST.update(key=key, scenario=scenario, stamps=stamps)
    found: OpenScenario = _LAST["scenario"]
    return found


def _stamps(*paths: Path) -> list[tuple[int, int] | None]:
    """Time and size of files, None for one that is missing."""
    found = [path.stat() if path.exists() else None for path in paths]
    return [state and (state.st_mtime_ns, state.st_size) for state in found]


def configured_events(config: DriveConfig) -> tuple[Event, ...]:
    """Returns the events of the configured file, with the values of its parameters.

    Raises:
      InputError: the file cannot be used, or does not have a parameter that the scenario lacks.
    """
    if config.events is None:
        return ()
    given = assignments(config.param)
    if config.scenario is not None:
        own, others = read_parameters(config.events), declared_parameters(config.scenario)
        given = {n: text for n, text in given.items() if n in own or n not in others}
    return read_events(config.events, given)


@task("reading the map")
def load_map(path: Path | None) -> RoadMap:
    """Returns the map of a file; without a path, the built-in highway.

    An OpenStreetMap extract or a SUMO net is converted first; see `map_sources.read_map`.

    Raises:
      MapError: the file cannot be used.
      TrafficError: netconvert, which converts it, is missing or does not end.
    """
    if path is None:
        return RoadMap.builtin()
    with suppress(OSError):
        if _LARGE_MAP < (size := path.stat().st_size) <= SIZE_LIMIT:
            remark(f"reading {path} ({size / 2**20:.0f} MB)")
    road_map = read_map(path)
    if road_map.notes:
        first, more = road_map.notes[0], len(road_map.notes) - 1
        remark(f"{path}: {first}" + (f" (and {more} more)" if more else ""))
    return road_map


def load_route(config: TruckStart) -> Route:
    """Returns the configured route on the configured map, with its cross slope and unevenness.

    Raises:
      InputError: the map has no such route, or the cross slope is too steep.
      MapError: the map cannot be used.
    """
    route = load_map(config.map).route(along=config.route)
    if config.cross_slope:
        outward = -1.0 if route.road_map.left_hand else 1.0
        route = route.with_cross_slope(outward * math.atan(0.01 * config.cross_slope))
    return route.with_unevenness(
        Unevenness(config.roughness, config.potholes, config.joint_spacing, config.road_seed)
    )


def surface_text(route: Route) -> str:
    """Returns cross slope and unevenness of a route in words, "smooth" without them."""
    outward = -1.0 if route.road_map.left_hand else 1.0
    slope = 100.0 * math.tan(outward * route.cross_slope)
    return f"{route.unevenness}" + (f", cross slope {slope:g} %" if slope else "")


def road_user_slots(config: DriveConfig) -> bool | dict[str, int]:
    """Returns the bodies for pedestrians, cyclists and obstacles, as `Mirror` takes them.

    They cost some time of the physics. SUMO's traffic has pedestrians and cyclists only if they are
    asked for.
    """
    sumo = not TRAFFIC.is_own(config.traffic_mode) and config.recording is None
    if config.pedestrians or config.bicycles:
        return ROAD_USER_POOL | CROWD
    return config.has_events or not sumo


@task("building the truck", usual=1.5)
def load_truck(
    config: TruckStart,
    route: Route,
    mirror: Mirror,
    *,
    timestep: float = TIMESTEP,
    visuals: bool = True,
    edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
) -> Truck:
    """Returns the configured truck on the route, in a model with the traffic's bodies.

    Bodies and joints do not depend on `visuals`.
    """

    def edit(spec: mujoco.MjSpec) -> None:
        mirror.add_to(spec)
        if visuals and isinstance(config, DriveConfig):
            _add_markings(spec, config, route)
        if edit_spec is not None:
            edit_spec(spec)

    return Truck.load(
        config.payload,
        truck=config.truck,
        payload_height=config.payload_height,
        route=route,
        timestep=timestep,
        plant=config.plant,
        visuals=visuals,
        edit_spec=edit,
    )


def _add_markings(spec: mujoco.MjSpec, config: DriveConfig, route: Route) -> None:
    """Adds the stop lines and crossings of SUMO's net where the map has none of its own."""
    if config.traffic_mode not in ("inter", "pure"):
        return
    try:
        found = net_markings(route, walkways=config.pedestrians > 0.0)
    except Error:
        return  # the traffic reports why there is no net; a recorded drive needs none
    add_paint(spec, route, found.stop_lines, found.yield_lines, found.crossings)


def make_recorder(config: DriveConfig, route: Route, footprint: EgoFootprint) -> Recorder:
    """Returns a recorder of the configured traffic on the route.

    Raises:
      InputError: the events cannot be used, or the traffic is recorded or none.
    """
    traffic = None
    if config.recording is None:
        traffic = make_traffic(config, route, footprint)
    if not isinstance(traffic, (PureSim, EventSim, OwnTraffic)):
        raise InputError(
            "only SUMO traffic, events and your own traffic can be recorded: use another "
            "traffic-mode or events, and no recording"
        )
    return Recorder(traffic)


def make_traffic(config: DriveConfig, route: Route, footprint: EgoFootprint) -> Traffic | None:
    """Returns the configured traffic on the route; None for an empty road.

    Raises:
      InputError: the recording or the events contradict another option or cannot be used.
    """
    if config.reactive and config.recording is None:
        raise InputError("reactive adds traffic to a recording: name one, or leave reactive out")
    own = TRAFFIC.is_own(config.traffic_mode)
    if own and config.recording is not None:
        raise InputError("a recording is a traffic, too: leave recording or your traffic-mode out")
    if config.reactive and config.traffic_mode != "inter":
        raise InputError("reactive adds SUMO traffic that sees the truck: use traffic-mode inter")
    replayed = config.recording is not None and not config.reactive
    without_sumo = replayed or config.traffic_mode == "none"
    if (config.pedestrians or config.bicycles) and (without_sumo or own):
        raise InputError(
            "pedestrians and bicycles need SUMO traffic: use traffic-mode inter or pure"
        )
    recorded = RepSim(route, config.recording) if config.recording and without_sumo else None
    if without_sumo and not config.has_events:
        return recorded
    events = configured_events(config)
    if config.scenario is not None:
        events = (*_read_scenario(config, config.scenario).events(route), *events)
    settings = TrafficConfig(
        density=config.density,
        heavy_share=config.heavy_share,
        speed_limit=traffic_speed(config, route),
        lane_change=config.lane_change,
        lane_discipline=config.lane_discipline,
        scope=config.traffic_scope,
        footprint=footprint,
        units=TruckParameters.load(config.truck).unit_shapes if config.pedestrians else (),
        events=events,
        pedestrians=config.pedestrians,
        bicycles=config.bicycles,
    )
    if without_sumo:
        return EventSim(route, settings, seed=config.seed, recorded=recorded)
    if own:
        return _own_traffic(config, route, settings)
    if config.recording is not None:
        return MixedSim(route, config.recording, settings, seed=config.seed)
    mode = InterSim if config.traffic_mode == "inter" else PureSim
    return mode(route, settings, seed=config.seed)


def traffic_speed(config: DriveConfig, route: Route) -> float:
    """Returns the speed limit of the traffic [m/s].

    It is the option `traffic_speed`, else the paper's speed, or with a level of service the limit
    of most of the route.
    """
    if config.traffic_speed is not None:
        return config.traffic_speed
    if config.density not in BOUNDS:
        return PAPER_TRAFFIC_SPEED
    lengths: dict[float, float] = {}
    for begin, end in itertools.pairwise(np.linspace(0.0, route.length, LIMIT_SAMPLES).tolist()):
        limit = min(float(route.speed_limit(0.5 * (begin + end))), UNLIMITED_SPEED)
        lengths[limit] = lengths.get(limit, 0.0) + end - begin
    return max(lengths, key=lambda limit: (lengths[limit], limit))


def _own_traffic(config: DriveConfig, route: Route, settings: TrafficConfig) -> OwnTraffic:
    offered = {"config": settings, "seed": config.seed, "footprint": settings.footprint}
    part = TRAFFIC.make(config.traffic_mode, route=route, **offered)
    if config.events is not None and not isinstance(part, PureSim):
        raise InputError("only SUMO traffic has events: use traffic-mode inter or pure")
    return OwnTraffic(part, route)


def make_stack(
    config: DriveConfig,
    route: Route,
    parameters: TruckParameters,
    reference: SpeedReference | None = None,
) -> Stack:
    """Returns the driving stack of a configuration.

    Args:
      config: of the drive.
      route: the truck's road.
      parameters: of the truck.
      reference: source of the reference speed; default: `make_reference`.

    Raises:
      InputError: the speed profile or the range of speeds is not usable, or a part of the user's
        own does not fit.
    """
    planner = PlannerConfig()
    speed = dataclasses.replace(planner.speed, cruise_speed=config.speed)
    keep_right = route.keep_right if config.keep_right == "map" else config.keep_right == "on"
    planner = dataclasses.replace(planner, speed=speed, keep_right=keep_right)
    offered = {"route": route, "parameters": parameters}
    return Stack(
        route,
        decision.make(
            config.decision, prices=config.prices(), parameters=parameters, seed=config.seed
        ),
        planner=planner,
        parameters=parameters,
        reference=reference or make_reference(config, route, parameters),
        trajectory_planner=PLANNER.make(config.planner, config=planner, **offered),
        lateral=LATERAL.make(config.lateral, **offered),
        longitudinal=LONGITUDINAL.make(config.longitudinal, **offered),
    )


def make_reference(
    config: DriveConfig, route: Route, parameters: TruckParameters
) -> SpeedReference:
    """Returns the source of the reference speed: a speed profile, PCC, a constant, or an own one.

    Raises:
      InputError: the profile is not usable or of another road, or the range is empty.
    """
    banded = config.speed_min is not None or config.speed_max is not None
    own = SPEED.make(config.speed_planner, route=route, parameters=parameters, speed=config.speed)
    if own is not None:
        if banded or config.speed_profile is not None:
            raise InputError(
                "a speed-planner of your own uses neither speed-min, speed-max nor speed-profile: "
                "leave them out"
            )
        return guarded_speed(own)
    if config.speed_profile is not None:
        if banded:
            raise InputError(
                "a speed-profile is followed unchanged: leave speed-min and speed-max out, which "
                "only speed-planner pcc uses"
            )
        if config.speed_planner == "cruise":
            raise InputError("a speed-profile is followed unchanged: leave speed-planner out")
        profile = read_profile(config.speed_profile)
        name = f"speed profile {str(config.speed_profile)!r}"
        check_covers(profile, config.start_station, float(route.length), name)
        return ProfileReference(profile)
    if config.speed_planner == "cruise":
        if banded:
            raise InputError("only speed-planner pcc uses speed-min and speed-max: leave them out")
        return CruiseReference(config.speed)
    # Load CasADi and SciPy's optimizers only for PCC.
    from controllers.pcc import PccReference, RecedingConfig

    # Without a limit of wall time: the load of the computer must not change the drive.
    receding = RecedingConfig(time_limit=math.inf)
    try:
        return PccReference(route, pcc_config(config), parameters, receding)
    except InputError as error:
        if banded:
            raise
        return CruiseReference(config.speed, f"no speed can be planned: {error}")


def pcc_config(config: DriveConfig) -> PccConfig:
    """Returns set speed and range of speeds for PCC.

    Raises:
      InputError: the reference speed is outside the range.
    """
    from controllers.pcc import PccConfig

    low = SLOWEST_SHARE * config.speed if config.speed_min is None else config.speed_min
    high = max(SPEED_LIMITER, config.speed) if config.speed_max is None else config.speed_max
    if not low <= config.speed <= high:
        raise InputError(
            f"speed {config.speed:g} m/s is outside speed-min {low:g} to speed-max {high:g} m/s"
        )
    return PccConfig(v_ref=config.speed, v_min=max(low, 1.0), v_max=high)
