"""Adaptive sweeps: find where the outcome changes, with few points.

A box is divided into cells, and the sides of cells whose points differ are bisected. A boundary is
a chord between the places found on the sides. A cell is halved along its longest side, as in a k-d
tree, when its chords may be off by more than these places are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray

DEPTH = 20  # halvings of a side of the first cells
# An arc with a radius of a quarter of the box is off its chord of length h by h^2 / 2, and a place
# in a bracket of length b by b / 2: the larger one of h^2 and b is halved. A cell without a
# boundary counts less by this factor: an island of another outcome may hide in it.
EXPLORED = 16.0
_GOLDEN = 0.6180339887498949  # its multiples spread a part of the cells over all
_ROUNDING = 1e-9
Node = tuple[int, ...]
Cell = tuple[Node, Node]


class Boundary:
    """The boundaries between outcomes in a box: ask for nodes, and enter them in `found`.

    Args:
      counts: nodes of the first grid along each axis, at least 2 each.

    Attributes:
      found: outcomes of the nodes; None is no outcome.
      cells: low and high corner of each cell, whole numbers; they fill the box.
    """

    def __init__(self, counts: Sequence[int]) -> None:
        self._spans = np.array([(count - 1) << DEPTH for count in counts])
        self.found: dict[Node, str | None] = {}
        step = 1 << DEPTH
        self.cells: list[Cell] = [
            (low, tuple(k + step for k in low))
            for low in itertools.product(*(range(0, span, step) for span in self._spans.tolist()))
        ]

    def share(self, node: Node) -> tuple[float, ...]:
        """Returns the place of a node as a share of each axis."""
        return tuple((np.array(node) / self._spans).tolist())

    def ask(self, limit: int) -> list[Node]:
        """Returns the nodes to evaluate next; none when `limit` of them cannot improve anything.

        The first nodes are those of the first grid, however many.
        """
        nodes = dict.fromkeys(self._missing(*self.cells))
        while not nodes:
            differ = self._differ()
            brackets = self.brackets()
            sizes = [
                float(max(np.subtract(high, low) / self._spans)) ** 2 / (1.0 if mixed else EXPLORED)
                for (low, high), mixed in zip(self.cells, differ, strict=True)
            ]
            longest, largest = max((b[2] for b in brackets), default=0.0), max(sizes)
            if longest >= largest:
                middles = [b[0] for b in brackets if b[2] == longest]
                return list(dict.fromkeys(_spread(middles)))[:limit]
            halves: dict[int, tuple[Cell, Cell]] = {}
            for k in _spread([k for k, size in enumerate(sizes) if size == largest]):
                pair = self._halved(self.cells[k])
                more = nodes | dict.fromkeys(self._missing(*pair))
                if len(more) <= limit:
                    nodes, halves[k] = more, pair
            if not halves or largest < 4.0 ** (1 - DEPTH):
                break
            self.cells = [c for k, cell in enumerate(self.cells) for c in halves.get(k, (cell,))]
        return list(nodes)

    def brackets(self) -> list[tuple[Node, int, float]]:
        """Returns middle, axis and length of the shortest stretches of sides with a boundary.

        Lengths are shares of the axis.
        """
        lines: dict[tuple[int, Node], list[int]] = {}
        for node in self.found:
            for axis, place in enumerate(node):
                lines.setdefault((axis, node[:axis] + node[axis + 1 :]), []).append(place)
        made: dict[tuple[int, Node], float] = {}
        for cell, mixed in zip(self.cells, self._differ(), strict=True):
            for corner, axis in itertools.product(_corners(cell), range(len(cell[0]))):
                if not mixed or corner[axis] != cell[0][axis]:
                    continue
                before, after = corner[:axis], corner[axis + 1 :]
                places = sorted(lines[axis, before + after])
                inside = [p for p in places if cell[0][axis] <= p <= cell[1][axis]]
                for low, high in itertools.pairwise(inside):
                    ends = {self.found[(*before, place, *after)] for place in (low, high)}
                    if None not in ends and len(ends) == 2 and high - low > 1:
                        middle = (*before, (low + high) // 2, *after)
                        made[axis, middle] = float((high - low) / self._spans[axis])
        return [(node, axis, length) for (axis, node), length in made.items()]

    def widths(self) -> tuple[float, ...]:
        """Returns the longest bracket along each axis as a share of it; () without a boundary.

        An axis along which nothing changes has the longest side of a cell with a boundary.
        """
        mixed = [c for c, differ in zip(self.cells, self._differ(), strict=True) if differ]
        if not mixed:
            return ()
        sides = np.max([np.subtract(high, low) / self._spans for low, high in mixed], axis=0)
        lengths = [[b[2] for b in self.brackets() if b[1] == axis] for axis in range(len(sides))]
        return tuple(
            max(found, default=side) for found, side in zip(lengths, sides.tolist(), strict=True)
        )

    def equal_grid(self) -> int:
        """Returns the number of points of a grid with these widths as its steps."""
        return math.prod(round(1.0 / width) + 1 for width in self.widths())

    def predicted(self, shares: FloatArray) -> list[str]:
        """Returns the outcomes at places between the nodes of a plane, by linear interpolation.

        What is interpolated is the distance to the nearest bracket, for each outcome positive at
        its nodes and negative at others.

        Args:
          shares: places as shares of the two axes, shape (n, 2).
        """
        # Load SciPy only for pictures.
        from scipy.spatial import Delaunay, KDTree

        known = {node: name for node, name in self.found.items() if name is not None}
        names = sorted(set(known.values()))
        places = np.array([self.share(node) for node in known])
        own = np.array([[name == each for each in names] for name in known.values()])
        middles = [self.share(node) for node, *_ in self.brackets()]
        distances = KDTree(middles).query(places)[0] if middles else np.ones(len(places))
        values = np.where(own, 1.0, -1.0) * distances[:, None]
        found = np.zeros(len(shares), dtype=int)
        # SciPy's interpolator solves a system for each triangle, in threads that hinder each other.
        for corners in Delaunay(places).simplices:
            first, (p, q) = places[corners[0]], places[corners[1:]] - places[corners[0]]
            x, y = (shares - first).T
            area = p[0] * q[1] - p[1] * q[0]
            if abs(area) < _ROUNDING**2:
                continue  # nodes on one line
            u, v = (x * q[1] - y * q[0]) / area, (y * p[0] - x * p[1]) / area
            parts = np.stack([1.0 - u - v, u, v], axis=1)
            inside = (parts >= -_ROUNDING).all(axis=1)
            found[inside] = np.argmax(parts[inside] @ values[corners], axis=1)
        return [names[k] for k in found.tolist()]

    def _missing(self, *cells: Cell) -> list[Node]:
        return [node for cell in cells for node in _corners(cell) if node not in self.found]

    def _differ(self) -> list[bool]:
        """Whether the nodes in each cell differ, also those on its sides."""
        known = [(node, name) for node, name in self.found.items() if name is not None]
        places = np.array([node for node, _ in known]).reshape(-1, len(self._spans))
        names = np.array([name for _, name in known])
        inside = (
            names[((places >= low) & (places <= high)).all(axis=1)] for low, high in self.cells
        )
        return [bool((each[1:] != each[:-1]).any()) for each in inside]

    def _halved(self, cell: Cell) -> tuple[Cell, Cell]:
        low, high = cell
        axis = int(np.argmax(np.subtract(high, low) / self._spans))
        middle = (low[axis] + high[axis]) // 2
        first = (*high[:axis], middle, *high[axis + 1 :])
        return (low, first), ((*low[:axis], middle, *low[axis + 1 :]), high)


def _spread(items: list) -> list:
    """The items in an order of which every beginning is spread over all."""
    order = sorted(range(len(items)), key=lambda k: (k * _GOLDEN) % 1.0)
    return [items[k] for k in order]


def _corners(cell: Cell) -> list[Node]:
    return list(itertools.product(*zip(*cell, strict=True)))
