"""Drives made of formulas, and what the script of a page reads from it."""

from __future__ import annotations

import base64
import gzip
import html.parser
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.render.drive_page import DriveReport
from iits_mj.render.pages import Film
from iits_mj.road import Route
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import COLUMNS


def drive(rows: int = 301, faster: float = 0.0, start: float = 0.0) -> DriveTable:
    """A drive on a straight road with a stop, two lane changes and no vehicle ahead at first."""
    time = start + 0.1 * np.arange(rows)
    speed = np.clip(12.0 + 4.0 * np.sin(0.3 * time) + faster, 0.0, None)
    speed[150:170] = 0.0
    station = 50.0 + np.concatenate([[0.0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))])
    columns = dict.fromkeys(COLUMNS, np.zeros(rows)) | {
        "time [s]": time,
        "station [m]": station,
        "x [m]": station,
        "y [m]": 3.5 * (time > 8.0),
        "speed [m/s]": speed,
        "gear [-]": np.round(speed / 2.0),
        "fuel_used [kg]": 0.01 * time,
        "articulation [rad]": 0.01 * np.sin(time),
        "plan_mode [-]": np.full(rows, np.nan),
        "lane [-]": 1.0 * (time > 8.0),
        "lane_changes [-]": (time > 8.0) + 1.0 * (time > 20.0),
        "gap_ahead [m]": np.where(time > 5.0, 40.0 - 0.5 * time, np.nan),
        "box_distance [m]": np.full(rows, np.nan),
    }
    return DriveTable({name: np.asarray(values, dtype=float) for name, values in columns.items()})


def report(table: DriveTable, film: Path | None = None) -> DriveReport:
    """The report of a drive on a straight road with a light."""
    return DriveReport(
        "iits-mj drive",
        "a drive",
        ["a remark"],
        table,
        Route.straight(2000.0),
        (200.0, 5000.0),
        [("distance", "0.4 km")],
        [("command line", "`iits-mj drive --seed 3`"), ("seed", "3")],
        [("density", "dense")],
        None if film is None else Film("Film, camera chase", film),
    )


class Content(html.parser.HTMLParser):
    """Collects the elements of a page: name, attributes, and text below."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self._inside: list[str] = [""]
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while tag in self._inside and self._inside.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        self.texts.append((self._inside[-1], data))

    def of(self, tag: str) -> list[dict[str, str | None]]:
        """Attributes of the elements of a name."""
        return [attributes for name, attributes in self.elements if name == tag]

    def words(self) -> str:
        """The text that a reader sees."""
        return " ".join(text for tag, text in self.texts if tag not in ("script", "style"))

    @property
    def sources(self) -> list[str]:
        """What the page loads or links to outside of itself."""
        found = [e.get("src") or e.get("href") or "" for _, e in self.elements]
        return [source for source in found if source and not source.startswith("#")]


def plotted(text: str) -> tuple[dict[str, Any], list[np.ndarray]]:
    """What a page's script reads: the plots, and the arrays by their places."""
    found = re.search(
        r'id="page-data">(.*?)</script>.*?id="arrays">(.*?)</script>', text, re.DOTALL
    )
    assert found
    page = json.loads(found[1])
    numbers = np.frombuffer(gzip.decompress(base64.b64decode(found[2])), "<f4")
    return page, np.split(numbers, np.cumsum(page["sizes"])[:-1])
