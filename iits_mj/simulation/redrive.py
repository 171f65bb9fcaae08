"""Repeats a recorded drive from its commands and compares truck and traffic bit by bit."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.own_parts import AnyPart, part_name, source_digest
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import (
    FILES,
    StateHash,
    options_of,
    stored_names,
    truck_of,
    truck_versions,
    without_own_parts,
)
from iits_mj.simulation.driver import CommandPlayer
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.loop import Simulation
from iits_mj.simulation.parts import load_route, make_traffic
from iits_mj.truck import Truck
from traffic_bridge import TRAFFIC, OwnTraffic, PoseDigest, Recording, VehicleFrame
from traffic_bridge.modes.resim import difference, traffic_of
from traffic_bridge.recording.provenance import demand_same
from traffic_bridge.recording.rows import ego_columns, ego_row


class RedriveError(Error):
    """A re-run is not bit-identical."""


class Redriven(NamedTuple):
    """Size and hashes of a re-run that is bit-identical.

    Attributes:
      frames: number, the reset included; commands: number that reached the truck.
      pose_hash: of the traffic's poses; truck_hash: of the truck's states, 64 bits.
    """

    frames: int
    commands: int
    pose_hash: str
    truck_hash: str


def redrive(
    recording: Recording,
    name: str,
    map_path: Path | None,
    truck: AnyTruck | None = None,
    progress: Callable[[DriveFrame], None] | None = None,
    traffic_mode: AnyPart = "inter",
) -> Redriven:
    """Repeats a recorded drive.

    Args:
      recording: of a drive, with its commands.
      name: of the recording in messages.
      map_path: the map's file; None: the built-in one.
      truck: of the drive; None: the shipped one of the recorded name.
      progress: called after each 100 ms.
      traffic_mode: the user's traffic, if the drive was recorded in one.

    Raises:
      InputError: another map, version, truck, parameter or traffic made it, or it has no drive.
      RedriveError: a pose or a state is not bit-identical; names it and its time.
      TrafficError: SUMO failed.
    """
    config = recorded_config(recording, name, map_path, truck)
    if len(recording) == 0 or len(recording.truck_hash) == 0:
        raise InputError(f"{name}: has no states of the truck, so that nothing can be compared")
    route = load_route(config)
    own = own_traffic_of(recording, name, route, traffic_mode, config)
    traffic = traffic_of(recording, name, route, own)

    def driver(_: Route, made: Truck) -> CommandPlayer:
        found = recording.meta["drive"].get("versions")
        demand_same(found, truck_versions(made.parameters), name)
        return CommandPlayer(functools.partial(_recorded, recording))

    with Simulation(config, driver=driver, traffic=lambda *_: traffic, visuals=False) as again:
        hashes, poses = StateHash(again.truck), PoseDigest()
        for k in range(len(recording)):
            frame = again.frame if k == 0 else again.cycle()
            vehicles = VehicleFrame.of(again.vehicles)
            poses.add(vehicles)
            _compare_truck(recording, k, frame.ego, hashes.add())
            found = difference(recording.frames[k], vehicles)
            if found:
                raise RedriveError(f"the traffic differs first at t = {frame.time:.2f} s: {found}")
            if progress is not None and k:
                progress(frame)
    if poses.hexdigest() != recording.meta.get("digest"):
        raise RedriveError("the hash of the recorded poses differs from the recorded hash")
    last = recording.truck_hash[-1] if len(recording.truck_hash) else 0
    count = int(np.searchsorted(recording.command_time, recording.time[-1] - 1e-6))
    return Redriven(len(recording), count, poses.hexdigest(), f"{int(last):016x}")


def own_traffic_of(
    recording: Recording, name: str, route: Route, traffic_mode: Any, world: DriveConfig
) -> OwnTraffic | None:
    """Returns the user's traffic of a recorded drive, ready for a reset; None for SUMO's.

    The user names the traffic again: a recording does not decide which code runs.

    Args:
      recording: of the drive.
      name: of the recording in messages.
      route: the truck's road.
      traffic_mode: the user's traffic, or "inter".
      world: has the map and the truck.

    Raises:
      InputError: the drive was recorded in another traffic, or its file has changed.
    """
    stored = options_of(recording, name)
    then = stored["traffic_mode"]
    if not TRAFFIC.is_own(traffic_mode):
        if TRAFFIC.is_own(then):
            raise InputError(f"{name}: made in your own traffic; add --traffic-mode {then}")
        return None
    given = part_name(traffic_mode)
    if given != then:
        raise InputError(f"{name}: made in traffic {then!r}, not {given!r}")
    if stored.get("events") is not None:
        raise InputError(f"{name}: has no copy of the events of your own traffic: replay it")
    digest = {"own traffic of hash": source_digest(traffic_mode)}
    demand_same(recording.meta["drive"].get("versions"), digest, name)
    config = recorded_config(recording, name, world.map, world.truck)
    footprint = TruckParameters.load(config.truck).footprint
    made = make_traffic(dataclasses.replace(config, traffic_mode=traffic_mode), route, footprint)
    assert isinstance(made, OwnTraffic)
    return made


def _compare_truck(recording: Recording, k: int, ego: EgoState, state_hash: int) -> None:
    now, then = np.array(ego_row(ego)), np.ascontiguousarray(recording.ego[k])
    if now.shape != then.shape:
        raise RedriveError(f"the truck has {len(now)} numbers of its state, recorded {len(then)}")
    apart = now.view(np.uint64) != then.view(np.uint64)
    if apart.any():
        place = int(np.argmax(apart))
        name = ego_columns(len(now))[place]
        raise RedriveError(
            f"the truck differs first at t = {recording.time[k]:.2f} s: {name} is "
            f"{float(now[place])!r}, recorded {float(then[place])!r}"
        )
    if k < len(recording.truck_hash) and int(recording.truck_hash[k]) != state_hash:
        raise RedriveError(
            f"the truck differs first at t = {recording.time[k]:.2f} s, in a state that it does "
            "not report"
        )


def recorded_config(
    recording: Recording, name: str, map_path: Path | None, truck: AnyTruck | None
) -> DriveConfig:
    """Returns the recorded options; the recorded commands pass directly to the truck.

    Raises:
      InputError: the recording has no drive, other options, or was of another map or truck.
    """
    options = options_of(recording, name)
    known = stored_names()
    if set(options) != known:
        other = sorted(set(options) ^ known)
        raise InputError(f"{name}: made with other options than today's: {', '.join(other)}")
    files = dict.fromkeys(known.intersection(FILES))
    changed = {"map": map_path, "truck": truck_of(options, name, truck), "commands": "direct"}
    changed["ego"] = None  # its file is not read again
    changed |= {"sensors": "perfect", "aeb": "off"}  # the commands have what came of them
    try:
        return DriveConfig(**{**without_own_parts(options), **files, **changed})
    except (TypeError, InputError) as error:
        raise InputError(f"{name}: a stored option is not usable: {error}") from error


def _recorded(recording: Recording, number: int, ego: EgoState) -> VehicleCommand:
    """Returns a command of the recording; raises RedriveError without one at this time."""
    times = recording.command_time
    if number >= len(times) or abs(times[number] - ego.time) > 1e-6:
        raise RedriveError(f"the recording has no command of t = {ego.time:.2f} s")
    return recording.command_at(number)
