"""A small map of the lanes about the truck, seen from above, with the traffic as boxes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from iits_mj.render.trajectory import MODE_COLORS
from iits_mj.road import Route

if TYPE_CHECKING:
    from iits_mj.simulation import Frame

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
    """Draws the sketch into the lower right corner of pictures of one size."""

    def __init__(self, size: tuple[int, int], scale: float, route: Route) -> None:
        self.route = route
        self._scale = scale
        width, height = round(WIDTH * scale), round(HEIGHT * scale)
        self._corner = (
            size[0] - width - round(MARGIN * scale),
            size[1] - height - round(MARGIN * scale),
        )
        large = (4 * width, 4 * height)
        background = Image.new("RGBA", large, (0, 0, 0, 0))
        ImageDraw.Draw(background).rounded_rectangle(
            (0, 0, large[0] - 1, large[1] - 1), radius=40 * scale, fill=PANEL
        )
        self._background = background.resize((width, height), Image.Resampling.LANCZOS)
        self._width, self._height = width, height
        self._pad = 6.0 * scale

    def draw(self, image: Image.Image, frame: Frame) -> None:
        """Draws what is around the truck in this frame."""
        image.paste(self._background, self._corner, self._background)
        pen = ImageDraw.Draw(image, "RGB")
        ego, route = frame.ego, self.route
        edges = route.lane_boundaries_at(ego.station)
        middle = 0.5 * (edges[0] + edges[-1])
        # Metres across; wide roads and a truck beside them still fit.
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
            return self._corner[0] + x, self._corner[1] + min(max(y, limit[0]), limit[1])

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
            # Predicted from the scene's instant to the frame's.
            station = vehicle.station + vehicle.speed * max(frame.time - frame.scene.time, 0.0)
            ahead = station - ego.station
            if abs(vehicle.offset - middle) > half or not -BEHIND < ahead < AHEAD:
                continue
            color = VEHICLE_COLORS.get(vehicle.kind, VEHICLE_COLORS["car"])
            self._box(pen, point, station, vehicle.offset, vehicle.length, vehicle.width, color)
        foot = frame.scene.footprint
        center = ego.station + foot.front_overhang - 0.5 * foot.length
        self._box(pen, point, center, ego.offset, foot.length, foot.width, TRUCK)

    def _plan(self, pen: ImageDraw.ImageDraw, frame: Frame, point: Project) -> None:
        plan = frame.trajectory
        shown = (plan.time >= frame.time) & (plan.station < frame.ego.station + AHEAD)
        if np.count_nonzero(shown) < 2:
            return
        red, green, blue = MODE_COLORS[plan.mode]
        color = (round(255 * red), round(255 * green), round(255 * blue))
        points = [
            point(float(s), float(o))
            for s, o in zip(plan.station[shown][::3], plan.offset[shown][::3], strict=True)
        ]
        if len(points) > 1:
            pen.line(points, fill=color, width=max(1, round(2.2 * self._scale)))

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
