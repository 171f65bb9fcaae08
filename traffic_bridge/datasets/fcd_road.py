"""One road out of SUMO's edges, from nothing but the vehicles that drove them."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray

MISFIT = 5.0  # [m]: by how much the place of an edge beside the chain may differ seen from its ends

Step = tuple[int, int]


def lay_out(
    name: NDArray[np.str_],
    time: FloatArray,
    edge: NDArray[np.str_],
    position: FloatArray,
    speed: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_], tuple[str, ...]]:
    """Stations along the chain of edges that most vehicles drive.

    Args:
      name: of the vehicle, shape (k,).
      time: [s], shape (k,).
      edge: shape (k,).
      position: along the edge [m], shape (k,).
      speed: [m/s], shape (k,).

    Returns:
      Stations [m], which rows are on the chain, each of shape (k,), and notes in words.
    """
    edges, number = np.unique(edge, return_inverse=True)
    ways = _ways(name, time, number.astype(np.int64), position, speed)
    count = Counter({step: len(found) for step, found in ways.items()})
    length = {step: float(np.median(found)) for step, found in ways.items()}
    chain = _chain(int(np.bincount(number).argmax()), count)
    begin = {chain[0]: 0.0}
    for a, b in itertools.pairwise(chain):
        begin[b] = begin[a] + length[a, b]
    _add_skipped(begin, length)
    table = np.array([begin.get(e, np.nan) for e in range(len(edges))])
    station = table[number] + position
    keep = np.isfinite(station)
    left_out = len(edges) - len(begin)
    notes = (
        f"{int((~keep).sum())} rows on {left_out} edges beside the most driven chain of "
        f"{len(begin)} are left out",
    )
    return np.where(keep, station, 0.0), keep, notes if left_out else ()


def _ways(
    name: NDArray[np.str_],
    time: FloatArray,
    edge: NDArray[np.int64],
    position: FloatArray,
    speed: FloatArray,
) -> dict[Step, list[float]]:
    """How far apart two edges begin, by every vehicle that passed from one to the other."""
    _, vehicle = np.unique(name, return_inverse=True)
    order = np.lexsort((time, vehicle))
    passed = (np.diff(vehicle[order]) == 0) & (np.diff(edge[order]) != 0)
    gaps = np.diff(time[order])
    same = np.diff(vehicle[order]) == 0
    usual = float(np.median(gaps[same])) if same.any() else 0.0
    passed &= gaps < 1.5 * usual
    a, b = order[:-1][passed], order[1:][passed]
    driven = 0.5 * (speed[a] + speed[b]) * gaps[passed]
    ways: dict[Step, list[float]] = {}
    for k, way in enumerate((position[a] + driven - position[b]).tolist()):
        ways.setdefault((int(edge[a[k]]), int(edge[b[k]])), []).append(way)
    return ways


def _chain(start: int, count: Counter[Step]) -> list[int]:
    """From the most driven edge on, and back, along the steps most often made."""
    chain = [start]
    while True:
        onward = {b: n for (a, b), n in count.items() if a == chain[-1] and b not in chain}
        if not onward:
            break
        chain.append(max(sorted(onward), key=onward.__getitem__))
    while True:
        back = {a: n for (a, b), n in count.items() if b == chain[0] and a not in chain}
        if not back:
            break
        chain.insert(0, max(sorted(back), key=back.__getitem__))
    return chain


def _add_skipped(begin: dict[int, float], length: Mapping[Step, float]) -> None:
    """Adds edges that lie between two of the chain (inside junctions, some vehicles skip them)."""
    for e in sorted({e for step in length for e in step} - begin.keys()):
        before = [begin[a] + way for (a, b), way in length.items() if b == e and a in begin]
        after = [begin[b] - way for (a, b), way in length.items() if a == e and b in begin]
        if before and after and abs(float(np.median(before)) - float(np.median(after))) < MISFIT:
            begin[e] = float(np.median(before))
