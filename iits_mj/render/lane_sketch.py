"""The planned trajectory as a ribbon on the road, and a small map of lanes and traffic."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from iits_mj.core.messages import PlanMode, Trajectory
from iits_mj.render.offscreen import Boxes
from iits_mj.road import Route

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame

MODE_COLORS: dict[PlanMode, tuple[float, float, float]] = {
    PlanMode.LANE_KEEPING: (0.10, 0.78, 0.62),
    PlanMode.LANE_CHANGE: (1.00, 0.66, 0.10),
    PlanMode.ABORT: (1.00, 0.40, 0.10),
    PlanMode.EMERGENCY: (0.95, 0.10, 0.12),
}
HALF_WIDTH, HALF_HEIGHT = 0.22, 0.012  # [m]
SHINE = (0.25, 0.5, 64.0)  # emission, specular, shininess
LIFT = 0.07
PIECES_MAX = 60
PIECE_LENGTH = 2.0
HIDDEN_START = 2.2  # [m] of the trajectory below the cab


def mode_color(mode: PlanMode) -> tuple[int, int, int]:
    """Returns the color of a mode for pictures."""
    red, green, blue = MODE_COLORS[mode]
    return round(255 * red), round(255 * green), round(255 * blue)


def trajectory_boxes(trajectory: Trajectory, time: float) -> Boxes:
    """Returns a ribbon along a trajectory from `time` [s] on, as `Offscreen.add_boxes` takes it."""
    points = _ribbon_points(trajectory, time)
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    count = max(len(steps), 1)
    fade = 0.85 - 0.6 * np.arange(len(steps)) / count
    kept = lengths >= 1e-6
    steps, lengths = steps[kept], lengths[kept, None]
    x = steps / lengths
    y = np.stack([-x[:, 1], x[:, 0], 0.0 * x[:, 0]], axis=1)
    y /= np.maximum(np.hypot(x[:, :1], x[:, 1:2]), 1e-9)
    middle = 0.5 * (points[:-1] + points[1:])[kept]
    places = np.stack(
        [(0.5 * lengths + 0.01) * x, HALF_WIDTH * y, HALF_HEIGHT * np.cross(x, y), middle], axis=2
    )
    looks = np.empty((len(places), 7), np.float32)
    looks[:, :3] = 0.85 * np.array(MODE_COLORS[trajectory.mode])
    looks[:, 3] = fade[kept]
    looks[:, 4:] = SHINE
    return places, looks


def _ribbon_points(trajectory: Trajectory, time: float) -> NDArray[np.float64]:
    """Returns points (n, 3) along the trajectory from `time` on, about 2 m apart."""
    path = np.stack([trajectory.x, trajectory.y, trajectory.z], axis=-1)
    if len(path) < 2 or not np.all(np.isfinite(path)):
        return np.empty((0, 3))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    start = float(np.interp(time, trajectory.time, way)) + HIDDEN_START
    if way[-1] - start < PIECE_LENGTH:
        return np.empty((0, 3))
    count = min(PIECES_MAX, int((way[-1] - start) / PIECE_LENGTH)) + 1
    wanted = np.linspace(start, way[-1], count)
    points = np.stack([np.interp(wanted, way, path[:, i]) for i in range(3)], axis=-1)
    points[:, 2] += LIFT
    return points


@contextlib.contextmanager
def region(picture: NDArray[np.uint8], box: tuple[int, int, int, int]) -> Iterator[Image.Image]:
    """Yields a part (left, top, width, height) of a picture to draw in; then writes it back."""
    left, top, width, height = box
    # The layout of small pictures may reach beyond their edge.
    left, top = max(left, 0), max(top, 0)
    part = picture[top : top + height, left : left + width]
    image = Image.fromarray(part)
    yield image
    part[:] = np.asarray(image)


Project = Callable[[float, float], tuple[float, float]]

WIDTH, HEIGHT = 104.0, 214.0  # at 960x540
MARGIN = 14.0
AHEAD, BEHIND = 90.0, 45.0  # [m] shown
PANEL = (14, 20, 27, 205)
ROAD = (58, 66, 74)
LINE = (176, 186, 196)
TRUCK = (226, 62, 54)
VEHICLE_COLORS = {
    "car": (120, 186, 255),
    "van": (150, 214, 190),
    "truck": (246, 190, 96),
    "articulated": (240, 150, 84),
}


class LaneSketch:
    """Draws lanes and vehicles, seen from above, for the lower right corner of pictures.

    Args:
      size: width and height of the pictures; scale: 1 for 960x540; route: with the lanes.

    Attributes:
      box: left, top, width and height of the sketch in the pictures.
    """

    def __init__(self, size: tuple[int, int], scale: float, route: Route) -> None:
        self.route = route
        self._scale = scale
        width, height = round(WIDTH * scale), round(HEIGHT * scale)
        corner = (size[0] - width - round(MARGIN * scale), size[1] - height - round(MARGIN * scale))
        self.box = (*corner, width, height)
        large = (4 * width, 4 * height)
        background = Image.new("RGBA", large, (0, 0, 0, 0))
        ImageDraw.Draw(background).rounded_rectangle(
            (0, 0, large[0] - 1, large[1] - 1), radius=40 * scale, fill=PANEL
        )
        self._background = background.resize((width, height), Image.Resampling.LANCZOS)
        self._width, self._height = width, height
        self._pad = 6.0 * scale

    def draw(self, image: Image.Image, frame: DriveFrame) -> None:
        """Draws the surroundings of the truck in this frame into an image of the box's size."""
        image.paste(self._background, (0, 0), self._background)
        pen = ImageDraw.Draw(image, "RGB")
        ego, route = frame.ego, self.route
        edges = route.lane_boundaries_at(ego.station)
        middle = 0.5 * (edges[0] + edges[-1])
        # Half the width of the map [m], enough for wide roads and a truck beside the road.
        half = max(0.5 * (edges[-1] - edges[0]) + 1.5, 7.5)
        stations = np.clip(
            np.linspace(ego.station - BEHIND, ego.station + AHEAD, 35), 0.0, route.length
        )
        count = len(edges) - 1
        lines = [np.asarray(route.boundary_offset(i, stations)) for i in range(count + 1)]

        def point(station: float, offset: float) -> tuple[float, float]:
            x = 0.5 * self._width - (offset - middle) / half * (0.5 * self._width - self._pad)
            share = (station - ego.station + BEHIND) / (AHEAD + BEHIND)
            y = self._height - self._pad - share * (self._height - 2 * self._pad)
            limit = (self._pad, self._height - self._pad)
            return x, min(max(y, limit[0]), limit[1])

        def path(offsets: np.ndarray) -> list[tuple[float, float]]:
            return [point(float(s), float(o)) for s, o in zip(stations, offsets, strict=True)]

        pen.polygon(path(lines[0]) + path(lines[-1])[::-1], fill=ROAD)
        stroke = max(1, round(1.2 * self._scale))
        for i, offsets in enumerate(lines):
            points = path(offsets)
            if 0 < i < count:
                for a, b in zip(points[::2], points[1::2], strict=False):
                    pen.line([a, b], fill=LINE, width=stroke)
            else:
                pen.line(points, fill=LINE, width=stroke)
        self._plan(pen, frame, point)
        for vehicle in frame.scene.vehicles:
            # Extrapolated from the time of the scene to the time of the frame.
            station = vehicle.station + vehicle.speed * max(frame.time - frame.scene.time, 0.0)
            ahead = station - ego.station
            if abs(vehicle.offset - middle) > half or not -BEHIND < ahead < AHEAD:
                continue
            color = VEHICLE_COLORS.get(vehicle.kind, VEHICLE_COLORS["car"])
            self._box(pen, point, station, vehicle.offset, vehicle.length, vehicle.width, color)
        foot = frame.scene.footprint
        center = ego.station + foot.front_overhang - 0.5 * foot.length
        self._box(pen, point, center, ego.offset, foot.length, foot.width, TRUCK)

    def _plan(self, pen: ImageDraw.ImageDraw, frame: DriveFrame, point: Project) -> None:
        plan = frame.trajectory
        shown = (plan.time >= frame.time) & (plan.station < frame.ego.station + AHEAD)
        if np.count_nonzero(shown) < 2:
            return
        points = [
            point(float(s), float(o))
            for s, o in zip(plan.station[shown][::3], plan.offset[shown][::3], strict=True)
        ]
        if len(points) > 1:
            pen.line(points, fill=mode_color(plan.mode), width=max(1, round(2.2 * self._scale)))

    def _box(
        self,
        pen: ImageDraw.ImageDraw,
        point: Project,
        station: float,
        offset: float,
        length: float,
        width: float,
        color: tuple[int, int, int],
    ) -> None:
        left, top = point(station + 0.5 * length, offset + 0.5 * width)
        right, bottom = point(station - 0.5 * length, offset - 0.5 * width)
        if bottom - top >= 1.0 and right - left >= 1.0:
            pen.rectangle((left, top, right, bottom), fill=color)
