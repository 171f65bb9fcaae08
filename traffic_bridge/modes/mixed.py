"""MixedSim: recorded vehicles drive as recorded; SUMO's traffic reacts to them and the truck."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from iits_mj.messages import EgoState
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.modes.guests import PREFIX, Guests
from traffic_bridge.modes.repsim import RepSim
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.modes.world import World
from traffic_bridge.recording.recording import Recording

LIVE = "live."


class MixedSim(PureSim):
    """Replayed vehicles and, around them, SUMO's traffic that brakes for and overtakes them.

    The replayed vehicles have their recorded names and are exactly where they were, whatever
    happens; SUMO's have names that begin with "live.". A replayed vehicle yields to nobody: it can
    drive into one of SUMO's that is slower, or that has stopped on its way (see `conflicts`).

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
        # A recording of such a mixture has these names already.
        self._prefix = LIVE
        while any(name.startswith(self._prefix) for name in recorded):
            self._prefix += LIVE
        self._conflicts: set[tuple[str, str]] = set()

    @property
    def duration(self) -> float:
        """Length of the recording [s]; afterwards SUMO's traffic goes on alone."""
        return self.replay.duration

    @property
    def conflicts(self) -> tuple[tuple[str, str], ...]:
        """Pairs of a replayed and a SUMO vehicle that touched since the reset, as SUMO sees it.

        SUMO counts who is nearer to the one ahead than the gap it keeps at standstill.
        """
        return tuple(sorted(self._conflicts))

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts SUMO anew around the replayed vehicles; see `PureSim.reset`."""
        self._conflicts = set()
        return self._with_replayed(super().reset(ego), ego)

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; see `PureSim.step`."""
        frame = super().step(ego)
        self._note_conflicts()
        return self._with_replayed(frame, ego)

    def _prepare(self, world: World) -> None:
        world.guests = Guests(
            world.session, world.lanes, self.route, self.replay, self.config.step_length
        )

    def _note_conflicts(self) -> None:
        for collision in self._running.session.api.simulation.getCollisions():
            pair = collision.collider, collision.victim
            guests = [name for name in pair if name.startswith(PREFIX)]
            others = [name for name in pair if name in self._running.vehicles]
            if guests and others:
                replayed = guests[0].removeprefix(PREFIX).removesuffix(".beside")
                self._conflicts.add((replayed, self._prefix + others[0]))

    def _with_replayed(self, live: VehicleFrame, ego: EgoState | None) -> VehicleFrame:
        replayed = self.replay.at(self.time)
        if ego is not None and math.isfinite(self.config.view_range):
            replayed = replayed.near(ego.x, ego.y, self.config.view_range)
        ids = [*(self._prefix + name for name in live.ids), *replayed.ids]
        order = sorted(range(len(ids)), key=ids.__getitem__)
        kinds = live.kinds + replayed.kinds
        return VehicleFrame(
            [ids[k] for k in order],
            [kinds[k] for k in order],
            np.concatenate((live.lanes, replayed.lanes))[order],
            np.concatenate((live.values, replayed.values)).T[:, order],
        )
