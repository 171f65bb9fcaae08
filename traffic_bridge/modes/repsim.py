"""RepSim replays recorded vehicles without SUMO; MixedSim adds SUMO's traffic around them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, SignalLamp
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.replayed_vehicles import OVERLAP_SUFFIX, PREFIX, ReplayedVehicles
from traffic_bridge.modes.sumo_modes import Mode, PureSim
from traffic_bridge.modes.sumo_traffic import SumoTraffic
from traffic_bridge.recording.provenance import check_map, load
from traffic_bridge.recording.recording import Recording
from traffic_bridge.recording.replay import InterpolatedRecording
from traffic_bridge.recording.rows import COLUMNS


class RepSim(Mode):
    """Replays recorded vehicles exactly, independent of the truck, without SUMO.

    Args:
      route: the ego's road.
      recording: file written by `Recorder.save`, or the recording itself.
      view_range: only vehicles within this distance of the ego are returned [m].
      step_length: time of a step [s].
      other_map: allow a recording of another map, for instance a map with changed signs: vehicles
        keep their recorded poses, independent of the road.

    Attributes:
      replay: the recording as a function of time.

    Raises:
      InputError: the file or an argument cannot be used, or the map differs.
    """

    def __init__(
        self,
        route: Route,
        recording: str | Path | Recording,
        view_range: float = math.inf,
        step_length: float = 0.1,
        *,
        other_map: bool = False,
    ) -> None:
        if not (view_range > 0.0 and 0.0 < step_length <= 1.0):
            raise InputError(
                f"view_range {view_range!r}, step_length {step_length!r}: "
                "must be positive, the step at most 1 s"
            )
        loaded, name = load(recording)
        if not other_map:
            check_map(loaded, name, route)
        if loaded.meta.get("schema") == 1:
            loaded = on_road(loaded, route)
        self.route = route
        self.view_range = view_range
        self.step_length = step_length
        self.replay = InterpolatedRecording(loaded)
        self._steps = 0

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._steps * self.step_length

    @property
    def duration(self) -> float:
        """Length of the recording [s]."""
        return self.replay.duration

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Returns to the beginning."""
        self._steps = 0
        return self.at(0.0, ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; after the end of the recording the frames are empty."""
        self._steps += 1
        return self.at(self.time, ego)

    def exact_vehicles(self, time: float) -> VehicleFrame | None:
        """Returns the recorded vehicles at a time between two steps [s]."""
        return self.replay.at(time)

    @property
    def lamps(self) -> tuple[SignalLamp, ...]:
        """The map's traffic lights as the recorded drive saw them."""
        return self.replay.signals_at(self.time).lamps

    def at(self, time: float, ego: EgoState | None = None) -> VehicleFrame:
        """The vehicles at any time, interpolated between the recorded frames.

        Args:
          time: since the recording's beginning [s].
          ego: if given, only vehicles within the view range are returned.

        Raises:
          InputError: the time is not finite.
        """
        frame = self.replay.at(time)
        if ego is None or math.isinf(self.view_range):
            return frame
        return frame.near(ego.x, ego.y, self.view_range)


def on_road(recording: Recording, route: Route) -> Recording:
    """A recording of schema 1 with pitch and roll from the road's slopes."""
    place = {name: k for k, name in enumerate(COLUMNS)}
    columns = np.array(recording.columns)
    point = route.evaluate(columns[place["station"]], columns[place["offset"]])
    turned = columns[place["yaw"]] - point.heading
    rise, bank = point.grade, np.tan(point.superelevation)
    # Slopes along and across the vehicle, positive up and up to the left.
    along = np.cos(turned) * rise + np.sin(turned) * bank
    across = np.cos(turned) * bank - np.sin(turned) * rise
    columns[place["pitch"]] = -np.arctan(along)
    columns[place["roll"]] = np.arctan(across)
    return dataclasses.replace(recording, columns=columns)


LIVE = "live."  # prefix of the names of SUMO's vehicles


class MixedSim(PureSim):
    """Replayed vehicles, and SUMO's traffic, which brakes for them and overtakes them.

    The replayed vehicles have their recorded names and poses. The names of SUMO's vehicles begin
    with "live.". A replayed vehicle does not react: it can hit a slower or stopped vehicle of
    SUMO's traffic (see `conflicts`).

    Args:
      route: the ego's road.
      recording: file written by `Recorder.save`, or the recording itself.
      config: settings of SUMO's traffic.
      seed: of SUMO's traffic.
      other_map: see `RepSim`.

    Raises:
      InputError: the recording cannot be used or is of another map, or the seed is not allowed.
    """

    mode = "MixedSim"
    with_ego = True

    def __init__(
        self,
        route: Route,
        recording: str | Path | Recording,
        config: TrafficConfig | None = None,
        seed: int = 0,
        *,
        other_map: bool = False,
    ) -> None:
        super().__init__(route, config, seed)
        self.replay = RepSim(route, recording, other_map=other_map).replay
        recorded = self.replay.recording.ids
        # A recording of a MixedSim has names with this prefix already.
        self._prefix = LIVE
        while any(name.startswith(self._prefix) for name in recorded):
            self._prefix += LIVE
        self._conflicts: set[tuple[str, str]] = set()

    @property
    def duration(self) -> float:
        """Length of the recording [s]; afterwards only SUMO's traffic remains."""
        return self.replay.duration

    @property
    def conflicts(self) -> tuple[tuple[str, str], ...]:
        """Pairs of a replayed and a SUMO vehicle that collided since the reset, as SUMO defines it.

        SUMO counts vehicles that are nearer to the leader than their minimum gap.
        """
        return tuple(sorted(self._conflicts))

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts SUMO again around the replayed vehicles; see `PureSim.reset`."""
        self._conflicts = set()
        return self._with_replayed(super().reset(ego), ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; see `PureSim.step`."""
        frame = super().step(ego)
        self._note_conflicts()
        return self._with_replayed(frame, ego)

    def exact_vehicles(self, time: float) -> VehicleFrame | None:
        """Returns the recorded vehicles at a time between two steps [s]."""
        return self.replay.at(time)

    def _prepare(self, world: SumoTraffic) -> None:
        world.replayed = ReplayedVehicles(
            world.session, world.lanes, self.replay, self.config.step_length
        )

    def _note_conflicts(self) -> None:
        for collision in self._running.session.api.simulation.getCollisions():
            pair = collision.collider, collision.victim
            replayed = [name for name in pair if name.startswith(PREFIX)]
            live = [name for name in pair if name in self._running.vehicles]
            if replayed and live:
                recorded = replayed[0].removeprefix(PREFIX).removesuffix(OVERLAP_SUFFIX)
                self._conflicts.add((recorded, self._prefix + live[0]))

    def _with_replayed(self, live: VehicleFrame, ego: EgoState | None) -> VehicleFrame:
        replayed = self.replay.at(self.time)
        if ego is not None and math.isfinite(self.config.view_range):
            replayed = replayed.near(ego.x, ego.y, self.config.view_range)
        named = [self._prefix + name for name in live.ids]
        columns = live.values.T
        return VehicleFrame.joined(VehicleFrame(named, live.kinds, live.lanes, columns), replayed)
