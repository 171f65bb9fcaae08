"""Recorder, and the two modes that live on its files: ReSim runs again, RepSim replays."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from iits_mj.errors import InputError, TrafficError
from iits_mj.messages import EgoState, TrackedVehicle
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes import InterSim, Mode, PureSim
from traffic_bridge.recording import SCHEMA, PoseDigest, Recording, versions
from traffic_bridge.replay import Replay


class Recorder(Mode):
    """Runs another mode and notes everything for a file.

    Args:
      traffic: a PureSim or InterSim.
    """

    def __init__(self, traffic: PureSim) -> None:
        self.traffic = traffic
        self.route = traffic.route
        self._clear()

    def _clear(self) -> None:
        self._digest = PoseDigest()
        self._time: list[float] = []
        self._egos: list[EgoState | None] = []
        self._frames: list[tuple[TrackedVehicle, ...]] = []

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self.traffic.time

    def reset(self, ego: EgoState | None = None) -> list[TrackedVehicle]:
        """Resets the traffic and forgets what was noted before."""
        self._clear()
        return self._note(ego, self.traffic.reset(ego))

    def step(self, ego: EgoState | None = None) -> list[TrackedVehicle]:
        """Steps the traffic and notes truck and vehicles."""
        return self._note(ego, self.traffic.step(ego))

    def _note(self, ego: EgoState | None, vehicles: list[TrackedVehicle]) -> list[TrackedVehicle]:
        self._time.append(self.traffic.time)
        self._egos.append(ego)
        self._frames.append(tuple(vehicles))
        self._digest.add(vehicles)
        return vehicles

    @property
    def recording(self) -> Recording:
        """What was noted so far."""
        meta = {
            "schema": SCHEMA,
            "mode": self.traffic.mode,
            "seed": self.traffic.seed,
            "config": self.traffic.config.as_dict(),
            "map_hash": self.route.road_map.content_hash,
            "map_name": self.route.road_map.path.name,
            "versions": versions(),
            "digest": self._digest.hexdigest(),
        }
        return Recording(meta, np.array(self._time), tuple(self._egos), tuple(self._frames))

    def save(self, path: str | Path) -> Path:
        """Writes the recording; see `traffic_bridge.recording`."""
        return self.recording.save(path)

    def close(self) -> None:
        """Ends the traffic; what was noted stays."""
        self.traffic.close()


class ReSim(Mode):
    """Simulates a recorded traffic again, bit for bit, from its configuration and the truck's log.

    Args:
      route: the same road as when recording.
      path: file written by `Recorder.save`.
      config: when given, it must be the recorded one.

    Raises:
      InputError: the file cannot be used, or was made with another map, version or option; the
        message says which.
    """

    def __init__(self, route: Route, path: str | Path, config: TrafficConfig | None = None) -> None:
        self.recording = Recording.load(path)
        meta = self.recording.meta
        self.route = route
        if meta["map_hash"] != route.road_map.content_hash:
            raise InputError(
                f"recording {path}: made on map {meta['map_name']!r} of hash "
                f"{meta['map_hash'][:12]}, not on {route.road_map.path.name!r} of hash "
                f"{route.road_map.content_hash[:12]}"
            )
        for name, version in versions().items():
            if meta["versions"].get(name) != version:
                raise InputError(
                    f"recording {path}: made with {name} {meta['versions'].get(name)}, here is "
                    f"{version}; a re-run would not be identical (RepSim replays it anyway)"
                )
        self.config = TrafficConfig.from_dict(meta["config"])
        if config is not None and config != self.config:
            names = [n for n, v in config.as_dict().items() if v != self.config.as_dict()[n]]
            raise InputError(f"recording {path}: made with other options: {', '.join(names)}")
        modes = {"PureSim": PureSim, "InterSim": InterSim}
        if meta["mode"] not in modes:
            raise InputError(f"recording {path}: mode {meta['mode']!r} cannot be re-run")
        self._traffic = modes[meta["mode"]](route, self.config, int(meta["seed"]))
        self._digest = PoseDigest()
        self._frame = 0

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self._traffic.time

    def __len__(self) -> int:
        """Number of recorded frames, the reset included."""
        return len(self.recording.frames)

    def reset(self, ego: EgoState | None = None) -> list[TrackedVehicle]:  # noqa: ARG002
        """Begins the re-run. The truck's state comes from the log, not from the argument."""
        self._digest = PoseDigest()
        self._frame = 0
        return self._note(self._traffic.reset(self.recording.egos[0]))

    def step(self, ego: EgoState | None = None) -> list[TrackedVehicle]:  # noqa: ARG002
        """Re-runs the next step. The truck's state comes from the log, not from the argument.

        Raises:
          TrafficError: the log has ended.
        """
        if self._frame >= len(self):
            raise TrafficError(f"the recording ends after {len(self) - 1} steps")
        return self._note(self._traffic.step(self.recording.egos[self._frame]))

    def _note(self, vehicles: list[TrackedVehicle]) -> list[TrackedVehicle]:
        self._frame += 1
        self._digest.add(vehicles)
        return vehicles

    def verify(self) -> str:
        """Runs to the end from where it is and compares the poses with the recorded ones.

        Returns:
          The hash of all poses.

        Raises:
          TrafficError: they are not bit-identical.
        """
        if self._frame == 0:
            self.reset()
        while self._frame < len(self):
            self.step()
        found, recorded = self._digest.hexdigest(), self.recording.meta["digest"]
        if found != recorded:
            raise TrafficError(
                f"the re-run differs from the recording: hash {found[:12]}, "
                f"recorded {recorded[:12]}"
            )
        return found

    def close(self) -> None:
        """Ends SUMO; may be called again."""
        self._traffic.close()


class RepSim(Mode):
    """Replays recorded vehicles exactly, whatever the truck does, without SUMO.

    Args:
      route: the ego's road; only its height and lanes are used by others.
      path: file written by `Recorder.save`.
      view_range: report only vehicles within this distance of the ego [m].
      step_length: time of a step [s].

    Raises:
      InputError: the file cannot be used.
    """

    def __init__(
        self,
        route: Route,
        path: str | Path,
        view_range: float = math.inf,
        step_length: float = 0.1,
    ) -> None:
        if not (view_range > 0.0 and 0.0 < step_length <= 1.0):
            raise InputError(
                f"view_range {view_range!r}, step_length {step_length!r}: "
                "must be positive, the step at most 1 s"
            )
        self.route = route
        self.view_range = view_range
        self.step_length = step_length
        self.replay = Replay(Recording.load(path))
        self._steps = 0

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._steps * self.step_length

    @property
    def duration(self) -> float:
        """Length of the recording [s]."""
        return self.replay.duration

    def reset(self, ego: EgoState | None = None) -> list[TrackedVehicle]:
        """Goes back to the beginning."""
        self._steps = 0
        return self.at(0.0, ego)

    def step(self, ego: EgoState | None = None) -> list[TrackedVehicle]:
        """Advances one step; after the end of the recording there are no vehicles."""
        self._steps += 1
        return self.at(self.time, ego)

    def at(self, time: float, ego: EgoState | None = None) -> list[TrackedVehicle]:
        """The vehicles at any time, between recorded frames by interpolation.

        Args:
          time: since the recording's beginning [s].
          ego: when given, only vehicles within the view range of it are returned.
        """
        vehicles = self.replay.at(time)
        if ego is None:
            return vehicles
        return [v for v in vehicles if math.hypot(v.x - ego.x, v.y - ego.y) <= self.view_range]
