"""A recorded drive in the browser with a time line, and as one page that needs no server."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.bag.mcap_file import Bag
from iits_mj.core.errors import InputError
from iits_mj.core.output_files import write_whole
from iits_mj.parameters import AnyTruck
from iits_mj.web import instruments
from iits_mj.web.server import WebServer
from iits_mj.web.stage import Stage
from iits_mj.web.track import Puppet, Track
from traffic_bridge import Recording

_FRAME = 0.02  # of wall time [s]
# Time constant of the heading that a replayed page looks along [s].
_TURN_TIME = 1.0
_RATE = 20.0


class Playback(Stage):
    """Plays a recorded drive; viewers play, pause and seek.

    Args:
      server: of the pages.
      track: of the drive.
      pace: time of the drive over wall time.
    """

    def __init__(self, server: WebServer, track: Track, pace: float = 1.0) -> None:
        self._track = track
        self._puppet = Puppet(track)
        self._times = track.time
        self._time = 0.0
        self._poses: dict[int, Any] = {}
        self._shown = -1
        super().__init__(server, pace)
        self._handlers |= {"seek": self._seek}
        overlays = {"show_gaps": "Gaps to other vehicles"}
        if track.plans:
            overlays["show_path"] = "Planned path"
        self.add_overlays(overlays)

    @property
    def now(self) -> float:
        """Time since the start of the drive [s]."""
        return self._time

    def play(self) -> None:
        """Plays until Ctrl-C; at the end the last instant stays."""
        # Loading viser takes half a second.
        from iits_mj.web.scene import TruckScene

        track = self._track
        self.scene = TruckScene(
            self.server.viser,
            self._puppet.truck.model,
            track.parameters,
            tuple(track.route.tunnels),
        )
        self.scene.initial_camera(self._at(0))
        self.scene.show_forces = False
        self.redraw()
        while True:
            self.between_cycles()
            if self._time >= track.duration:
                self.wait()
                continue
            self._time = min(self._time + _FRAME * self.pace, track.duration)
            if self.due():
                self.redraw()
            self.hold()

    def redraw(self) -> None:
        """Draws the present instant."""
        scene, index = self.scene, self._index
        if scene is None:
            return
        track, times = self._track, self._times
        after = min(index + 1, len(times) - 1)
        span = times[after] - times[index]
        share = (self._time - times[index]) / span if span > 0.0 else 0.0
        ego = track.states[index]
        poses = self._at(index).toward(self._at(after), share)
        scene.show(poses, ego.station, self._time + track.states[0].time)
        if self._shown != index:
            self._shown = index
            at = track.scene(index)
            scene.show_neighbors(ego.time, track.vehicles[index], instruments.gap_texts(at))
            scene.show_plan(track.plans[index] if track.plans else None)
            scene.show_lights(at.signals, ego.time)

    def state(self) -> dict[str, Any]:
        """Returns the instruments."""
        track, index = self._track, self._index
        ego = track.states[index]
        lane = int(track.route.lane_at(ego.station, ego.offset))
        gap, _ = track.scene(index).neighbors.corridor_gaps(lane)
        rows = [
            ("gap ahead", f"{gap:.0f} m" if math.isfinite(gap) else "free"),
            ("station", f"{ego.station:.0f} m"),
            ("time", f"{ego.time:.1f} s"),
        ]
        return {
            **instruments.truck_state(ego, track.commands[index]),
            "rows": instruments.truck_rows(ego) + rows,
            "timeline": [round(self._time, 2), round(track.duration, 2)],
        }

    def message(self, page: int, content: dict[str, Any]) -> None:
        """Receives the place on the time line."""
        super().message(page, content)
        seek = content.get("seek")
        if isinstance(seek, (int, float)) and math.isfinite(seek):
            self.requests.put("seek", float(seek))

    @property
    def _index(self) -> int:
        """The newest recorded instant."""
        return max(int(np.searchsorted(self._times, self._time + 1e-9, side="right")) - 1, 0)

    def _at(self, index: int) -> Any:
        from iits_mj.web.scene import Poses

        if index not in self._poses:
            # Only neighbors in time are needed again.
            self._poses = {k: v for k, v in self._poses.items() if abs(k - index) <= 2}
            self._poses[index] = Poses.of(self._puppet.place(index))
        return self._poses[index]

    def _seek(self, value: float) -> None:
        self._time = min(max(value, 0.0), self._track.duration)
        self.jump()
        self.redraw()


def replay_page(
    drive: Recording | Bag | Track,
    path: Path,
    *,
    map_path: Path | None = None,
    truck: AnyTruck | None = None,
    start: float = 0.0,
    duration: float = 60.0,
    rate: float = _RATE,
    view: str = "chase",
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Writes one HTML file that replays a drive in 3-D; it needs no server and no network.

    The page has a time line with play, pause and speed. The mouse turns and moves the camera, which
    stays behind the truck. Inside the drive's report, it follows and moves the report's cursor.

    Args:
      drive: recording, bag, or the track of a drive (`iits_mj.web.track.TrackObserver`).
      path: of the page.
      map_path: the drive's map; None: the built-in one.
      truck: of the drive; None: the shipped one of the recorded name.
      start: of the replayed part, since the drive's start [s].
      duration: of the replayed part at most [s].
      rate: pictures a second.
      view: one of `iits_mj.render.cameras.CAMERAS`, in which the page starts.
      progress: called with the share that is done.

    Returns:
      The path.

    Raises:
      InputError: the drive cannot be shown, or the page cannot be written.
    """
    from iits_mj.web.scene import Poses, TruckScene

    track = Track.of(drive, map_path=map_path, truck=truck)
    times = track.time
    first = int(np.searchsorted(times, start))
    if first >= len(times) - 1:
        raise InputError(f"replay: start {start:g} s is beyond the drive's {times[-1]:.1f} s")
    end = min(start + duration, float(times[-1]))
    puppet = Puppet(track)
    instants = np.arange(times[first], end + 1e-6, 1.0 / rate)
    driven = np.array(
        [(track.states[k].x, track.states[k].y) for k in range(first, len(times), 20)]
    )
    driven = driven[: max(math.ceil((end - times[first]) / 2.0) + 1, 2)]
    with WebServer(port=0, title="iits-mj replay") as server:
        scene = TruckScene(
            server.viser, puppet.truck.model, track.parameters, near=driven, overlays=False
        )
        poses = {first: Poses.of(puppet.place(first))}
        heading = track.states[first].yaw
        scene.show(poses[first], turned=heading)
        scene.initial_camera(poses[first], view, turned=heading)
        serializer = server.viser.get_scene_serializer()
        for number, instant in enumerate(instants):
            index = min(
                int(np.searchsorted(times, instant + 1e-9, side="right")) - 1, len(times) - 2
            )
            for k in (index, index + 1):
                if k not in poses:
                    poses[k] = Poses.of(puppet.place(k))
            poses = {k: poses[k] for k in (index, index + 1)}
            share = (instant - times[index]) / (times[index + 1] - times[index])
            turn = math.remainder(track.states[index].yaw - heading, 2.0 * math.pi)
            heading += turn * (1.0 - math.exp(-1.0 / (rate * _TURN_TIME)))
            scene.show(poses[index].toward(poses[index + 1], float(share)), turned=heading)
            scene.show_lights(track.signals[index], track.states[index].time)
            serializer.insert_sleep(1.0 / rate)
            if progress is not None:
                progress((number + 1) / len(instants))
        page = serializer.as_html()
    times_shown = track.states[0].time + instants[[0, -1]]
    write_whole(path, (page + _script(*times_shown)).encode(), "replay")
    return path


def _script(first: float, last: float) -> str:
    """Returns the script that ties a replay to the report around it, times in [s]."""
    text = Path(__file__).with_name("page").joinpath("replay.js").read_text(encoding="utf-8")
    return f"<script>\nconst FIRST = {first:.3f}, LAST = {last:.3f};\n{text}</script>\n"
