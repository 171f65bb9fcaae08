"""Traffic lights of a running simulation: states, phases, programs, and the next one ahead."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from iits_mj.core.checks import in_range, is_number, is_whole
from iits_mj.core.errors import InputError
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.overrides import Overrides, Undo
from traffic_bridge.session import Session
from traffic_bridge.signals.events import LIGHT_LETTERS

BY_HAND = "online"  # SUMO's name of the program after a state was set by hand
SAME_STOP_LINE = 5.0  # [m]
FIXED_TIME = 0  # SUMO's number of the program type with fixed durations


@dataclass(frozen=True)
class LightAhead:
    """The next traffic light on the route.

    Attributes:
      name: of the light; link: index of the route's link in its state.
      letter: state of that link now, see `LightPhase`.
      station: of its stop line [m].
      lane: from the outside, whose link it is.
      next_switch: time until the letter changes [s]; None if it is unknown: a state set by hand, a
        program that depends on the traffic, or one in which the letter never changes.
      next_letter: the letter after that; None if the time is.
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


@dataclass(frozen=True)
class LightPhase:
    """One phase of a program.

    Attributes:
      duration: [s].
      state: one letter per link: r red, u red-yellow, y yellow, g green that yields, G green,
        s stop, then go when free, o blinking, O off.
    """

    duration: float
    state: str

    def __post_init__(self) -> None:
        """Checks both values."""
        in_range("a phase's duration", self.duration, 0.1, 3600.0)
        _check_state("a phase", self.state, len(str(self.state)))


@dataclass(frozen=True)
class _Setting:
    """What a light does: it runs a named program, or shows a state set by hand."""

    program: str = ""
    state: str = ""


class TrafficLights:
    """The traffic lights of the net."""

    def __init__(self, session: Session, lanes: RouteLanes) -> None:
        self._session = session
        self._api = session.api.trafficlight
        self._simulation = session.api.simulation
        self._names = tuple(sorted(self._api.getIDList()))
        self._stops = stop_lines(self._api, self._names, lanes)
        # Temporary settings, and what each light did before the first of them.
        self._overrides = Overrides()
        self._before: dict[str, _Setting] = {}

    def names(self) -> tuple[str, ...]:
        """Names of the traffic lights of the net, sorted."""
        return self._names

    def state(self, light: str) -> str:
        """State of a light, one letter per link, see `LightPhase`."""
        self._check(light)
        with self._reading(light):
            return str(self._api.getRedYellowGreenState(light))

    def set_state(self, light: str, state: str) -> None:
        """Sets a light by hand until something else is set; ends all temporary settings.

        Args:
          light: its name.
          state: one letter per link as returned by `state`, or a single letter for all links.

        Raises:
          InputError: no such light, a wrong letter or a wrong number of letters.
        """
        setting = _Setting(state=self._whole_state(light, state))
        self._overrides.forget(light)
        self._set(light, setting)

    def hold_state(self, light: str, state: str) -> Undo:
        """Sets a light by hand temporarily.

        Of several temporary states and programs the newest one is in force.

        Args:
          light: its name.
          state: as of `set_state`.

        Returns:
          A function that ends it. Then the newest other temporary setting holds, or else what the
          light did before all of them.

        Raises:
          InputError: as `set_state`.
        """
        return self._hold(light, _Setting(state=self._whole_state(light, state)))

    def hold_program(self, light: str, program: str) -> Undo:
        """Runs a program temporarily, see `hold_state`.

        Raises:
          InputError: no such light or program.
        """
        self._logic(light, program)
        return self._hold(light, _Setting(program))

    def programs(self, light: str) -> tuple[str, ...]:
        """Names of a light's programs."""
        return tuple(name for name in self._logics(light) if name != BY_HAND)

    def program(self, light: str) -> str | None:
        """Name of the running program; None after a state was set by hand."""
        self._check(light)
        with self._reading(light):
            name = str(self._api.getProgram(light))
        return None if name == BY_HAND else name

    def phases(self, light: str, program: str | None = None) -> tuple[LightPhase, ...]:
        """The phases of a program, by default of the running one, in their order.

        Raises:
          InputError: no such light or program, or no program runs.
        """
        logic = self._logic(light, self._running(light) if program is None else program)
        return tuple(LightPhase(float(p.duration), str(p.state)) for p in logic.phases)

    def phase(self, light: str) -> int:
        """Index of the running phase of a light's program, in `phases`.

        Raises:
          InputError: no such light, or no program runs.
        """
        self._running(light)
        with self._reading(light):
            return int(self._api.getPhase(light))

    def set_phase(self, light: str, phase: int, duration: float | None = None) -> None:
        """Switches to a phase of the running program at once.

        Args:
          light: its name.
          phase: index in `phases`; the program continues from there.
          duration: of this phase this time [s]; None: as in the program.

        Raises:
          InputError: no such light or phase, no program runs, or the duration is not allowed.
        """
        count = len(self.phases(light))
        if not is_whole(phase) or not 0 <= phase < count:
            raise InputError(
                f"phase {phase!r} of traffic light {light!r}: allowed is 0 to {count - 1}"
            )
        if duration is not None:
            LightPhase(duration, "r")
        with self._session.guard(f"setting traffic light {light}"):
            self._api.setPhase(light, phase)
            if duration is not None:
                self._api.setPhaseDuration(light, duration)

    def define_program(self, light: str, program: str, phases: Sequence[LightPhase]) -> None:
        """Adds a fixed-time program; `run_program` starts it.

        Args:
          light: its name.
          program: a name that the light does not have yet.
          phases: in their order; they repeat.

        Raises:
          InputError: no such light, a name in use, no phase, or a state of a wrong length.
        """
        links = len(self.state(light))
        if not isinstance(program, str) or not program or program == BY_HAND:
            raise InputError(f"program {program!r}: must be a name other than {BY_HAND!r}")
        if program in self.programs(light):
            raise InputError(f"traffic light {light!r} has a program {program!r} already")
        if not phases:
            raise InputError(f"program {program!r} of traffic light {light!r}: it has no phase")
        for phase in phases:
            _check_state(f"program {program!r} of traffic light {light!r}", phase.state, links)
        with self._session.guard(f"defining a program of traffic light {light}"):
            running = self._api.getProgram(light)
            make = self._api
            steps = [make.Phase(p.duration, p.state, p.duration, p.duration) for p in phases]
            make.setProgramLogic(light, make.Logic(program, FIXED_TIME, 0, steps))
            # SUMO starts a new program at once; the running one must continue.
            make.setProgram(light, running)

    def run_program(self, light: str, program: str = "0") -> None:
        """Runs one of a light's programs; ends all temporary settings.

        Raises:
          InputError: no such light or program.
        """
        self._logic(light, program)
        self._overrides.forget(light)
        self._set(light, _Setting(program))

    def ahead(self, station: float, lane: int | None = None) -> LightAhead | None:
        """The next light on the ego's route at or after a station; None if there is none.

        Args:
          station: of the front bumper [m].
          lane: from the outside; None: the outermost lane that leads on along the route.

        Raises:
          InputError: the station is not finite, or the lane is no whole number from 0.
        """
        if not is_number(station):
            raise InputError(f"station {station!r}: must be a finite number")
        if lane is not None and (not is_whole(lane) or lane < 0):
            raise InputError(f"lane {lane!r}: must be a whole number from 0 or None")
        ahead = [stop for stop in self._stops if stop[0] >= station and lane in (None, stop[1])]
        if not ahead:
            return None
        # Lanes of one stop line end within meters of each other; the rightmost one is reported.
        near = [stop for stop in ahead if stop[0] < ahead[0][0] + SAME_STOP_LINE]
        line, own_lane, light, link = min(near, key=lambda stop: stop[1])
        letter = self.state(light)[link]
        wait, after = self._next_letter(light, link)
        return LightAhead(light, link, letter, line, own_lane, wait, after)

    def _reading(self, light: str) -> AbstractContextManager[None]:
        return self._session.guard(f"reading traffic light {light}")

    def _whole_state(self, light: str, state: str) -> str:
        """A state with one letter per link; a single letter is repeated."""
        links = len(self.state(light))
        whole = state * links if isinstance(state, str) and len(state) == 1 else state
        _check_state(f"traffic light {light!r}", whole, links)
        return whole

    def _running(self, light: str) -> str:
        """The running program; InputError if the light was set by hand."""
        name = self.program(light)
        if name is None:
            raise InputError(f"traffic light {light!r} was set by hand: no program runs")
        return name

    def _hold(self, light: str, setting: _Setting) -> Undo:
        if self._overrides.newest("setting", light) is None:
            self._before[light] = self._present(light)
        undo = self._overrides.add(light, {"setting": setting}, lambda: self._restore(light))
        self._set(light, setting)
        return undo

    def _restore(self, light: str) -> None:
        """Applies the newest temporary setting, or else the one before all of them."""
        setting = self._overrides.newest("setting", light) or self._before[light]
        # Setting a running program again would restart it.
        if setting != self._present(light):
            self._set(light, setting)

    def _present(self, light: str) -> _Setting:
        program = self.program(light)
        return _Setting(state=self.state(light)) if program is None else _Setting(program)

    def _set(self, light: str, setting: _Setting) -> None:
        with self._session.guard(f"setting traffic light {light}"):
            if setting.program:
                self._api.setProgram(light, setting.program)
            else:
                self._api.setRedYellowGreenState(light, setting.state)

    def _next_letter(self, light: str, link: int) -> tuple[float | None, str | None]:
        name = self.program(light)
        if name is None or (logic := self._logic(light, name)).type != FIXED_TIME:
            return None, None
        with self._reading(light):
            wait = float(self._api.getNextSwitch(light)) - float(self._simulation.getTime())
            index = int(self._api.getPhase(light))
        return next_letter(logic.phases, index, wait, link)

    def _logics(self, light: str) -> dict[str, Any]:
        self._check(light)
        with self._reading(light):
            return {logic.programID: logic for logic in self._api.getAllProgramLogics(light)}

    def _logic(self, light: str, program: str) -> Any:
        known = self._logics(light)
        if program not in known:
            raise InputError(
                f"program {program!r} of traffic light {light!r}: there are "
                f"{', '.join(self.programs(light))}"
            )
        return known[program]

    def _check(self, light: str) -> None:
        if light not in self._names:
            known = ", ".join(self._names) or "none"
            raise InputError(f"no traffic light {light!r} in the net; there are: {known}")


def _check_state(what: str, state: object, links: int) -> None:
    if (
        not isinstance(state, str)
        or len(state) != links
        or not state
        or any(letter not in LIGHT_LETTERS for letter in state)
    ):
        raise InputError(f"state {state!r} of {what}: {links or 1} letters of {LIGHT_LETTERS!r}")


def next_letter(
    phases: Sequence[Any], index: int, wait: float, link: int
) -> tuple[float | None, str | None]:
    """Time until a link's letter changes in a fixed-time program [s], and the new letter.

    Args:
      phases: SUMO's, of the program.
      index: of the running phase.
      wait: time until the running phase ends [s].
      link: index of the letter.

    Returns:
      None, None if the letter never changes.
    """
    letter = phases[index].state[link]
    for _ in range(len(phases)):
        # A phase may name its successor; otherwise the next phase follows, cyclically.
        following = phases[index].next
        index = following[0] if following else (index + 1) % len(phases)
        if phases[index].state[link] != letter:
            return max(wait, 0.0), str(phases[index].state[link])
        wait += float(phases[index].duration)
    return None, None


def lines_without_light(lanes: RouteLanes) -> tuple[float, ...]:
    """Stations of the stop lines on the route before junctions without a light [m], sorted."""
    onward = dict(zip(lanes.edges, lanes.edges[1:], strict=False))
    found = set()
    for link in lanes.net.connections:
        table, offset = lanes.tables.get(link.start), lanes.net.lanes[link.start].stop_offset
        if table is None or table.direction <= 0 or link.light or offset == 0.0:
            continue
        if onward.get(table.edge) == link.end.rpartition("_")[0]:
            found.add(table.at(table.length - offset)[0])
    return tuple(sorted(found))


def stop_lines(
    lights_api: Any, names: Sequence[str], lanes: RouteLanes
) -> tuple[tuple[float, int, str, int], ...]:
    """Station [m], lane, light and link of every stop line on the route, in driving order."""
    onward = dict(zip(lanes.edges, lanes.edges[1:], strict=False))
    stops = []
    for light in names:
        for link, ways in enumerate(lights_api.getControlledLinks(light)):
            for before, after, _ in ways:
                table = lanes.tables.get(before)
                if table is None or table.lane < 0 or table.direction < 0:
                    continue
                if onward.get(table.edge) == after.rpartition("_")[0]:
                    line = table.length - lanes.net.lanes[before].stop_offset
                    stops.append((table.at(line)[0], table.lane, light, link))
    return tuple(sorted(stops))
