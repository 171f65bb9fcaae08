"""RoadMap: a whole OpenDRIVE map, and the routes through it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from iits_mj.road.chain import RoadGraph, join
from iits_mj.road.elements import OpenDriveMap, Road
from iits_mj.road.opendrive import parse
from iits_mj.road.reference_line import KNOT_SPACING
from iits_mj.road.route import Route
from iits_mj.road.seams import ContinuousChain
from iits_mj.road.xml_input import content_hash, read_file

MAPS = Path(__file__).resolve().parent / "maps"
# Beyond about 0.12 rad a laden truck that does not hurry tips or slides to the inside.
SUPERELEVATION_LIMIT = 0.10


class RoadMap:
    """A map: its roads, and chains of them to drive on.

    Attributes:
      path: the file, or a name in words for a road made in memory.
      roads: by id, in the order of the file.
      content_hash: SHA-256 of the file.
      notes: what of the file is not used, in words.
    """

    def __init__(self, content: OpenDriveMap, path: str | Path, digest: str | None = None) -> None:
        """Takes parsed records; use `from_opendrive` for a file."""
        self.path = Path(path)
        self.content = content
        self.roads: dict[str, Road] = {road.id: road for road in content.roads}
        self.content_hash = content_hash(repr(content).encode()) if digest is None else digest
        self.notes = content.notes
        self._graph = RoadGraph(content, str(self.path))

    @classmethod
    def from_opendrive(cls, path: str | Path) -> RoadMap:
        """Reads an OpenDRIVE file.

        Raises:
          MapError: it cannot be used; the message names file, road and what is wrong.
        """
        content = read_file(Path(path))
        return cls(parse(content, str(path)), path, content_hash(content))

    @classmethod
    def builtin(cls) -> RoadMap:
        """Our own highway of 15 km; its SUMO net lies beside it, as `highway.net.xml`."""
        return cls.from_opendrive(MAPS / "highway.xodr")

    def routes(self) -> list[tuple[str, int]]:
        """(road id, direction) of every place where a chain can begin."""
        return self._graph.starts()

    def route(
        self,
        start: str | None = None,
        superelevation_limit: float = SUPERELEVATION_LIMIT,
        knot_spacing: float = KNOT_SPACING,
    ) -> Route:
        """A chain of roads as one road.

        Args:
          start: "ID" or "ID:-1" of the first road; by default the longest chain of the map.
          superelevation_limit: a route whose cross slope exceeds it anywhere [rad] has all its
            cross slopes scaled down to it, because a truck would fall over.
          knot_spacing: of the reference line's samples [m].

        Raises:
          MapError: no drivable road, no such start, or roads that do not meet.
        """
        source = str(self.path)
        pieces = join(self.roads, self._graph.chain(start), source)
        steepest = max(
            float(
                np.max(
                    np.abs(
                        piece.road.superelevation.evaluate(
                            np.linspace(piece.s_start, piece.s_end, max(int(piece.length), 10))
                        )
                    )
                )
            )
            for piece in pieces
        )
        notes = self.notes
        scale = 1.0
        if steepest > superelevation_limit:
            scale = superelevation_limit / steepest
            notes = (
                *notes,
                f"cross slopes up to {math.degrees(steepest):.1f} degrees are scaled down to "
                f"{math.degrees(superelevation_limit):.1f}, at which a truck stays upright",
            )
        return Route(self, ContinuousChain(pieces, source, scale), knot_spacing, notes)
