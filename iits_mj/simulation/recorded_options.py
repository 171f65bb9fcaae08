"""Options beside a recording: those given must be those of then, or have a meaning at all."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

from iits_mj.errors import InputError
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import stored_options
from traffic_bridge import Recording, read_events
from traffic_bridge.modes.resim import config_of

# Files whose content the recording holds itself or checks by its hash.
FILES = ("map", "recording", "events", "speed_profile")
# What SUMO's traffic is asked for; recorded traffic alone hears none of it.
OF_SUMO = (
    *("density", "traffic_speed", "traffic_mode"),
    *("lane_change", "lane_discipline", "traffic_scope", "seed"),
)
_MODES = {"InterSim": "inter", "PureSim": "pure"}


def check_given(config: DriveConfig, given: Collection[str]) -> None:
    """Refuses options of SUMO's traffic where there is none but the recorded one.

    Args:
      config: of a drive.
      given: names of the options that somebody asked for.

    Raises:
      InputError: names the first.
    """
    if config.recording is None or config.reactive:
        return
    for name in OF_SUMO:
        if name in given:
            raise InputError(
                f"{_flag(name)} has no meaning in recorded traffic, which stays as it was; leave "
                "it out, or add --reactive for SUMO traffic around it"
            )


def check_options(
    recording: Recording, name: str, asked: DriveConfig, given: Collection[str]
) -> None:
    """Refuses options that are given and differ from those of a recording.

    Args:
      recording: that is to be run again.
      name: how messages call it.
      asked: the options.
      given: names of those that somebody asked for; the others are as in the recording.

    Raises:
      InputError: names the first that differs; or the events' file cannot be used.
    """
    values = stored_options(asked)
    then = options_of(recording, name) if "drive" in recording.meta else _of_traffic(recording)
    for field in dataclasses.fields(DriveConfig):
        if field.name not in given or field.name in FILES:
            continue
        flag, value = field.name.replace("_", "-"), values[field.name]
        if field.name not in then:
            raise InputError(f"{name}: does not hold {flag}, asked is {flag} {value}")
        if value != then[field.name]:
            raise InputError(
                f"{name}: made with {flag} {then[field.name]}, asked is {flag} {value}"
            )
    if "events" in given and asked.events is not None:
        events, stored = read_events(asked.events), config_of(recording, name).events
        if events != stored:
            was = "other events than those" if stored else "no events, asked are those"
            raise InputError(f"{name}: made with {was} of {asked.events}")


def options_of(recording: Recording, name: str) -> dict[str, Any]:
    """The options of a recorded drive.

    Raises:
      InputError: it is of a traffic without a drive.
    """
    drive = recording.meta.get("drive")
    if not isinstance(drive, dict) or not isinstance(drive.get("options"), dict):
        raise InputError(f"{name}: is of a traffic without a drive: its truck cannot be driven")
    return dict(drive["options"])


def _of_traffic(recording: Recording) -> dict[str, Any]:
    """The same options, as far as a traffic without a drive has them."""
    meta = recording.meta
    config = meta.get("config")
    stored = config if isinstance(config, Mapping) else {}
    return {
        "density": stored.get("density"),
        "traffic_speed": stored.get("speed_limit"),
        "traffic_mode": _MODES.get(str(meta.get("mode"))),
        "lane_change": stored.get("lane_change"),
        "lane_discipline": stored.get("lane_discipline"),
        "traffic_scope": stored.get("scope"),
        "seed": meta.get("seed"),
    }


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
