"""The instrument panel of a video: speed, gear, engine, pedals, brakes, grade, plan and lanes.

The static background is drawn once at four times the size and scaled down. Each frame adds
needles, bars and text.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from iits_mj.core.messages import Decision, PlanMode
from iits_mj.core.units import DIESEL_DENSITY, RPM
from iits_mj.render.lamps import change_of
from iits_mj.render.lane_sketch import MARGIN, PANEL, LaneSketch, mode_color, region
from iits_mj.road import Route

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame

Color = tuple[int, int, int]
Box = tuple[float, float, float, float]

INK: Color = (238, 242, 246)
DIM: Color = (150, 162, 174)
TRACK: Color = (52, 62, 72)
GREEN: Color = (46, 204, 150)
RED: Color = (235, 74, 70)
AMBER: Color = (255, 176, 46)
BLUE: Color = (86, 168, 255)
RPM_MAX, RPM_RED = 2500.0, 2100.0
BRAKE_PRESSURE_MAX = 850e3
MODE_NAMES = {
    PlanMode.LANE_KEEPING: "LANE KEEPING",
    PlanMode.LANE_CHANGE: "LANE CHANGE",
    PlanMode.ABORT: "ABORT",
    PlanMode.EMERGENCY: "EMERGENCY",
}
_PANEL_SIZE = (382.0, 112.0)
_PLAN_HEIGHT = 27.0
_OVERSAMPLING = 4


class Overlay:
    """Draws instruments into pictures of one size.

    Args:
      size: width and height of the pictures.
      route: for the map of the lanes.
      cameras: that share the pictures; the instruments of several are smaller.

    Attributes:
      boxes: left, top, width and height of the panel and of the map in the pictures.
    """

    def __init__(self, size: tuple[int, int], route: Route, cameras: int = 1) -> None:
        self.size = size
        width, height = size
        # The layout for 960x540 is scaled, so that small pictures show all instruments.
        self.scale = min(width / 960.0, height / 540.0) * (1.0 if cameras == 1 else 0.5)
        k = self.scale
        # Above the truck, which no view hides.
        left, top = MARGIN * k, (MARGIN + _PLAN_HEIGHT + 8.0) * k
        self._corner = (round(left), round(top))
        # Of the panel's layout in the region that is drawn.
        self._origin = (left - self._corner[0], top - self._corner[1])
        self._fonts = {
            points: ImageFont.load_default(max(points * k, 4.0)) for points in (46, 24, 15, 12, 10)
        }
        self._background = self._draw_background()
        self._sketch = LaneSketch(size, k, route)
        self.boxes = ((*self._corner, *self._background.size), self._sketch.box)

    def draw(self, picture: NDArray[np.uint8], frame: DriveFrame) -> NDArray[np.uint8]:
        """Draws the instruments into the picture (height, width, 3) and returns it."""
        # Only the regions with instruments are converted to images and back.
        with region(picture, (*self._corner, *self._background.size)) as image:
            image.paste(self._background, (0, 0), self._background)
            pen = ImageDraw.Draw(image, "RGB")
            self._speed(pen, frame)
            self._engine(pen, frame)
            self._pedals(pen, frame)
            self._brakes(pen, frame)
            self._grade(pen, frame)
            self._clock(pen, frame)
        with region(picture, (0, 0, self.size[0], math.ceil(44 * self.scale))) as image:
            self._plan(ImageDraw.Draw(image, "RGB"), frame)
        with region(picture, self._sketch.box) as image:
            self._sketch.draw(image, frame)
        return picture

    def _speed(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        self._text(pen, 76, 58, f"{abs(frame.ego.speed) * 3.6:.0f}", 46, INK, "rs")
        self._text(pen, 82, 58, "km/h", 12, DIM, "ls")
        self._text(pen, 16, 78, "SET", 10, DIM, "ls")
        self._text(pen, 44, 78, f"{frame.reference_speed * 3.6:.0f}", 15, GREEN, "ls")
        if math.isfinite(frame.speed_limit):
            self._text(pen, 74, 78, "LIMIT", 10, DIM, "ls")
            self._text(pen, 108, 78, f"{frame.speed_limit * 3.6:.0f}", 15, INK, "ls")

    def _engine(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        ego = frame.ego
        gear = {0: "N", -1: "R"}.get(ego.gear, str(ego.gear))
        self._text(pen, 162, 47, gear, 24, AMBER if ego.shift_in_process else INK, "mm")
        rpm = max(ego.engine_speed, 0.0) / RPM
        share = min(rpm / RPM_MAX, 1.0)
        color = RED if rpm > RPM_RED else BLUE
        box = self._box(132, 17, 192, 77)
        width = max(2, round(5 * self.scale))
        pen.arc(box, 135.0, 135.0 + 270.0 * share, fill=color, width=width)
        self._text(pen, 162, 73, f"{rpm:.0f}", 12, INK, "mm")

    def _pedals(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        pedal = min(max(frame.command.accelerator_pedal, 0.0), 1.0)
        brake = min(max(-frame.command.xbr_demand / 4.0, 0.0), 1.0)
        # Of engine brake and retarder, the stronger demand.
        slow = min(max(frame.command.engine_brake, frame.command.retarder, 0.0), 1.0)
        for x, share, color in ((200, pedal, GREEN), (220, slow, BLUE), (240, brake, RED)):
            if share > 0.005:
                pen.rectangle(self._box(x, 78 - 58 * share, x + 12, 78), fill=color)

    def _brakes(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        for i, pressure in enumerate(frame.ego.brake_pressures):
            share = min(max(pressure / BRAKE_PRESSURE_MAX, 0.0), 1.0)
            if share > 0.005:
                x = 260 + 11 * i
                pen.rectangle(self._box(x, 78 - 58 * share, x + 8, 78), fill=AMBER)

    def _grade(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        slope = frame.grade
        # The wedge is six times as steep as the road.
        rise = 6.0 * min(max(slope, -0.1), 0.1) * 36.0
        base = 62.0
        points = [(324, base + 0.5 * rise), (370, base - 0.5 * rise)]
        low = max(y for _, y in points) + 4.0
        polygon = [*points, (370, low), (324, low)]
        pen.polygon([self._point(x, y) for x, y in polygon], fill=BLUE if slope >= 0 else GREEN)
        self._text(pen, 347, 34, f"{100.0 * slope:+.1f} %", 15, INK, "mm")
        used = frame.ego.fuel_used / DIESEL_DENSITY
        self._text(pen, 370, 102, f"{used:.2f} l", 12, INK, "rs")

    def _plan(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        mode = frame.trajectory.mode
        name = MODE_NAMES[mode]
        if mode is PlanMode.LANE_CHANGE:
            side = change_of(frame.trajectory, frame.ego.offset)
            name += {Decision.LEFT: " LEFT", Decision.RIGHT: " RIGHT"}.get(side, "")
        k = self.scale
        font = self._fonts[15]
        width = font.getlength(name)
        x, y = MARGIN * k, MARGIN * k
        box = (x, y, x + width + 36 * k, y + _PLAN_HEIGHT * k)
        pen.rounded_rectangle(box, radius=6 * k, fill=PANEL[:3])
        pen.ellipse((x + 9 * k, y + 8.5 * k, x + 19 * k, y + 18.5 * k), fill=mode_color(mode))
        pen.text((x + 26 * k, y + 13.5 * k), name, font=font, fill=INK, anchor="lm")
        reason = frame.trajectory.reason
        if reason:
            font = self._fonts[12]
            reason = reason if len(reason) <= 90 else reason[:89] + "…"
            where = (box[2] + 10 * k, y + 13.5 * k)
            for shift in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
                pen.text(
                    (where[0] + shift[0], where[1] + shift[1]),
                    reason,
                    font=font,
                    fill=PANEL[:3],
                    anchor="lm",
                )
            pen.text(where, reason, font=font, fill=INK, anchor="lm")

    def _clock(self, pen: ImageDraw.ImageDraw, frame: DriveFrame) -> None:
        texts = (
            (16, f"{frame.time:6.1f} s"),
            (76, f"{frame.ego.station / 1000.0:.2f} km"),
            (140, f"changes {frame.lane_changes}"),
            (216, f"gap {frame.gap_ahead:.0f} m" if frame.gap_ahead < 500.0 else "gap free"),
        )
        for x, text in texts:
            self._text(pen, x, 102, text, 12, INK, "ls")

    def _point(self, x: float, y: float) -> tuple[float, float]:
        return self._origin[0] + x * self.scale, self._origin[1] + y * self.scale

    def _box(self, left: float, top: float, right: float, bottom: float) -> Box:
        return (*self._point(left, top), *self._point(right, bottom))

    def _text(
        self,
        pen: ImageDraw.ImageDraw,
        x: float,
        y: float,
        text: str,
        points: int,
        color: Color,
        anchor: str,
    ) -> None:
        pen.text(self._point(x, y), text, font=self._fonts[points], fill=color, anchor=anchor)

    def _draw_background(self) -> Image.Image:
        k = self.scale
        large = k * _OVERSAMPLING
        width, height = (round(value * large) for value in _PANEL_SIZE)
        image = Image.new("RGBA", (width, height), (0, 0, 0, 0))
        pen = ImageDraw.Draw(image)
        pen.rounded_rectangle((0, 0, width - 1, height - 1), radius=10 * large, fill=PANEL)

        def box(left: float, top: float, right: float, bottom: float) -> Box:
            return (left * large, top * large, right * large, bottom * large)

        pen.arc(box(132, 17, 192, 77), 135, 405, fill=TRACK, width=round(5 * large))
        end = 135.0 + 270.0 * RPM_RED / RPM_MAX
        pen.arc(box(129, 14, 195, 80), end, 405, fill=RED, width=round(1.6 * large))
        for x in (200, 220, 240):
            pen.rectangle(box(x, 20, x + 12, 78), fill=TRACK)
        for i in range(5):
            pen.rectangle(box(260 + 11 * i, 20, 268 + 11 * i, 78), fill=TRACK)
        pen.line(
            (12 * large, 86 * large, (_PANEL_SIZE[0] - 12) * large, 86 * large),
            fill=TRACK,
            width=round(large),
        )
        image = image.resize(
            (max(1, round(_PANEL_SIZE[0] * k)), max(1, round(_PANEL_SIZE[1] * k))),
            Image.Resampling.LANCZOS,
        )
        pen = ImageDraw.Draw(image)
        labels = (
            (162, 12, "rpm"),
            (206, 12, "gas"),
            (226, 12, "ret"),
            (246, 12, "xbr"),
            (286, 12, "brakes"),
            (347, 12, "grade"),
        )
        for x, y, text in labels:
            pen.text((x * k, y * k), text, font=self._fonts[10], fill=DIM, anchor="mm")
        return image
