"""ReSim: runs a recorded traffic again from its settings, seed and recorded truck states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.event_sim import REPEATABLE, EventSim, Repeatable
from traffic_bridge.modes.sumo_modes import Mode
from traffic_bridge.network.nets import build_network
from traffic_bridge.own_traffic import OwnTraffic
from traffic_bridge.recording.provenance import check_map, demand_same, load, net_hash, versions
from traffic_bridge.recording.recording import PoseDigest, Recording
from traffic_bridge.recording.rows import COLUMNS


def traffic_of(
    recording: Recording, name: str, route: Route, own: OwnTraffic | None = None
) -> Repeatable | OwnTraffic:
    """The traffic of a recording, ready for a reset.

    Args:
      recording: with the settings.
      name: of the recording in messages.
      route: the ego's road.
      own: the user's traffic that was recorded; None if it was SUMO's.

    Raises:
      InputError: it was made with another map, net or version, or cannot be re-run.
    """
    meta = recording.meta
    mode = meta.get("mode")
    if own is not None and own.mode != mode:
        raise InputError(f"{name}: made in traffic {mode!r}, not {own.mode!r}")
    if own is None and mode not in REPEATABLE:
        raise InputError(
            f"{name}: mode {mode!r} cannot be re-run; 'iits-mj replay' and RepSim replay its "
            "vehicles"
        )
    if len(recording) == 0:
        raise InputError(f"{name}: has no frames")
    check_map(recording, name, route)
    advice = "; a re-run would not be identical (RepSim replays it anyway)"
    found = _texts(meta.get("versions"))
    if meta.get("schema") == 1:
        found["schema"] = "1"
    demand_same(found, versions(), name, advice)
    if own is not None:
        return own
    if mode != EventSim.mode:
        net = {"a SUMO net of hash": net_hash(build_network(route, whole=False).path)}
        demand_same({"a SUMO net of hash": str(meta.get("net_hash"))}, net, name, advice)
    seed = meta.get("seed")
    if not isinstance(seed, int):
        raise InputError(f"{name}: has no seed")
    return REPEATABLE[str(mode)](route, config_of(recording, name), seed)


def config_of(recording: Recording, name: str) -> TrafficConfig:
    """The traffic settings of a recording; InputError if they are missing or not usable."""
    config = recording.meta.get("config")
    if not isinstance(config, dict):
        raise InputError(f"{name}: has no settings")
    try:
        return TrafficConfig.from_dict(config)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _texts(values: Any) -> dict[str, str]:
    return {str(k): str(v) for k, v in values.items()} if isinstance(values, dict) else {}


def difference(recorded: VehicleFrame, found: VehicleFrame) -> str:
    """Describes the first difference between two frames; "" if they are bit-identical."""
    if recorded.ids != found.ids:
        name = min(set(recorded.ids) ^ set(found.ids))
        return f"vehicle {name!r} is {'missing' if name in recorded.ids else 'there in addition'}"
    if recorded.kinds != found.kinds or not np.array_equal(recorded.lanes, found.lanes):
        return "kinds or lanes differ"
    apart = recorded.values.view(np.uint64) != found.values.view(np.uint64)
    if not apart.any():
        return ""
    row, column = np.argwhere(apart)[0]
    name = (*COLUMNS, "length", "width", "height")[column]
    return (
        f"{name} of vehicle {recorded.ids[row]!r} is {float(found.values[row, column])!r}, "
        f"recorded {float(recorded.values[row, column])!r}"
    )


class ReSim(Mode):
    """Runs a recorded simulation again from its settings, seed and recorded truck states.

    Args:
      route: the same road as in the recording.
      path: file written by `Recorder.save`, or the recording itself.
      config: expected settings; None: those of the file.
      own: the user's traffic that was recorded; None if it was SUMO's.

    Attributes:
      recording: the given one; config: its settings, None for the user's traffic.

    Raises:
      InputError: the file cannot be used, or was made with another map, version or option, named
        in the message.
    """

    def __init__(
        self,
        route: Route,
        path: str | Path | Recording,
        config: TrafficConfig | None = None,
        own: OwnTraffic | None = None,
    ) -> None:
        self.recording, self._name = load(path)
        self.route = route
        self._traffic = traffic_of(self.recording, self._name, route, own)
        self.config = None if isinstance(self._traffic, OwnTraffic) else self._traffic.config
        if config is not None and config != self.config:
            then = {} if self.config is None else self.config.as_dict()
            names = [n for n, v in config.as_dict().items() if v != then.get(n)]
            raise InputError(f"{self._name}: made with other options: {', '.join(names)}")
        self._digest = PoseDigest()
        self._frame = 0
        self._apart = ""

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self._traffic.time

    def __len__(self) -> int:
        """Number of recorded frames, the reset included."""
        return len(self.recording)

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:  # noqa: ARG002
        """Starts the re-run with the recorded state of the truck; ignores the argument."""
        self._digest = PoseDigest()
        self._frame = 0
        self._apart = ""
        return self._note(self._traffic.reset(self.recording.ego_at(0)))

    def step(self, ego: EgoState | None = None) -> VehicleFrame:  # noqa: ARG002
        """Re-runs the next step with the recorded state of the truck; ignores the argument.

        Raises:
          TrafficError: the recording has ended.
        """
        if self._frame >= len(self):
            raise TrafficError(f"the recording ends after {len(self) - 1} steps")
        return self._note(self._traffic.step(self.recording.ego_at(self._frame)))

    def _note(self, vehicles: VehicleFrame) -> VehicleFrame:
        frame = VehicleFrame.of(vehicles)
        if not self._apart:
            found = difference(self.recording.frames[self._frame], frame)
            if found:
                time = float(self.recording.time[self._frame])
                self._apart = f"first at t = {time:.2f} s, where {found}"
        self._frame += 1
        self._digest.add(frame)
        return frame

    def verify(self) -> str:
        """Runs to the end and compares the poses with the recorded ones.

        Returns:
          The hash of all poses.

        Raises:
          TrafficError: they are not bit-identical; names the first difference.
        """
        if self._frame == 0:
            self.reset()
        while self._frame < len(self) and not self._apart:
            self.step()
        if self._apart:
            raise TrafficError(f"the re-run differs from the recording: {self._apart}")
        found, recorded = self._digest.hexdigest(), str(self.recording.meta.get("digest"))
        if found != recorded:
            raise TrafficError(
                f"the re-run differs from the recording: hash {found[:12]}, "
                f"recorded {recorded[:12]}"
            )
        return found

    def close(self) -> None:
        """Ends SUMO; may be called again."""
        self._traffic.close()
