"""What is told of the next traffic light on the route, and where stop lines are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from traffic_bridge.network.lanes import RouteLanes


@dataclass(frozen=True)
class LightAhead:
    """The next traffic light on the route.

    Attributes:
      name: of the light; link: index of the route's link in its state.
      letter: state of that link now, see `LightPhase`.
      station: of its stop line [m].
      lane: from the right, whose link it is.
      next_switch: time until the letter changes [s]; None where nobody can know it: set by hand,
        a program that follows the traffic, or one in which the letter never changes.
      next_letter: what it changes to; None where the time is.
    """

    name: str
    link: int
    letter: str
    station: float
    lane: int
    next_switch: float | None
    next_letter: str | None

    @property
    def is_open(self) -> bool:
        """True while the letter lets vehicles go."""
        return self.letter in "gGoO"


def next_letter(
    phases: Sequence[Any], index: int, wait: float, link: int
) -> tuple[float | None, str | None]:
    """When a link's letter changes in a program of fixed times [s], and to what; None: never.

    Args:
      phases: SUMO's, of the program.
      index: of the running one.
      wait: time until the running one ends [s].
      link: index of the letter.
    """
    letter = phases[index].state[link]
    for _ in range(len(phases)):
        # A phase may name its successor; else it is the next, and after the last the first.
        following = phases[index].next
        index = following[0] if following else (index + 1) % len(phases)
        if phases[index].state[link] != letter:
            return max(wait, 0.0), str(phases[index].state[link])
        wait += float(phases[index].duration)
    return None, None


def stop_lines(
    lights_api: Any, names: Sequence[str], lanes: RouteLanes
) -> tuple[tuple[float, int, str, int], ...]:
    """Station [m], lane, light and link of every stop line on the route, in driving order.

    Args:
      lights_api: libsumo's domain of traffic lights.
      names: of the lights.
      lanes: of the route.
    """
    onward = dict(zip(lanes.edges, lanes.edges[1:], strict=False))
    stops = []
    for light in names:
        for link, ways in enumerate(lights_api.getControlledLinks(light)):
            for before, after, _ in ways:
                table = lanes.tables.get(before)
                if table is None or table.lane < 0 or table.direction < 0:
                    continue
                if onward.get(table.edge) == after.rpartition("_")[0]:
                    stops.append((table.at(table.length)[0], table.lane, light, link))
    return tuple(sorted(stops))
