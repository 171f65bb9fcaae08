"""Runs several traffic simulations at once, each in its own process, as libsumo holds only one.

    with TrafficWorlds([WorldSpec(route, config, seed=k) for k in range(8)]) as worlds:
        frames = worlds.reset(egos)
        frames = worlds.step(egos)      # all of them by 0.1 s, in parallel

The results are bit-identical to those of the same mode in this process. The processes are spawned,
so a script that makes worlds needs the usual `if __name__ == "__main__":`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from iits_mj.core.checks import is_number, shown, whole
from iits_mj.core.context import Closing
from iits_mj.core.errors import Error, InputError, TrafficError
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.sumo_modes import MODES, Mode, PureSim
from traffic_bridge.modes.world_process import END_TIME, Failure, WorldProcess, message_of

START_TIME = 120.0  # [s] for the imports of a process
INTERRUPTED = "was ended by an interrupt; reset it to start it again"


@dataclass(frozen=True)
class WorldSpec:
    """Settings of one traffic simulation of `TrafficWorlds`.

    Attributes:
      route: the ego's road.
      config: settings of the traffic.
      seed: of all random numbers, 0 to 2^31 - 1; `TrafficWorlds.reset` may change it.
      mode: "InterSim" or "PureSim".

    Raises:
      InputError: no route or configuration, an unknown mode, or a seed that is not usable.
    """

    route: Route
    config: TrafficConfig = field(default_factory=TrafficConfig)
    seed: int = 0
    mode: str = "InterSim"

    def __post_init__(self) -> None:
        """Checks the values before a process is started."""
        if not isinstance(self.mode, str) or self.mode not in MODES:
            raise InputError(f"mode {shown(self.mode)} of a world: allowed are {', '.join(MODES)}")
        if not isinstance(self.config, TrafficConfig):
            raise InputError(f"a world needs a TrafficConfig, not {shown(self.config)}")
        object.__setattr__(self, "seed", self().seed)

    def __call__(self) -> PureSim:
        """Makes the simulation; it is not reset yet."""
        return MODES[self.mode](self.route, self.config, self.seed)


class TrafficWorlds(Closing):
    """N traffic simulations in parallel, stepped together.

    Every method waits for the answers of its worlds. If one world fails, the others complete the
    request; the first failure is raised with the number of its world. A failed world works again
    after a reset, also if its process has ended.

    Args:
      specs: one for each world.
      timeout: a world without an answer for this time is ended [s].

    Attributes:
      specs: one for each world, with the present seeds.

    Raises:
      InputError: no spec, or a value that is not usable.
      TrafficError: a process cannot be started.
    """

    def __init__(self, specs: Iterable[WorldSpec], timeout: float = 120.0) -> None:
        self.specs = tuple(specs) if isinstance(specs, Iterable) else ()
        if not self.specs or not all(isinstance(spec, WorldSpec) for spec in self.specs):
            raise InputError("TrafficWorlds needs at least one WorldSpec, and nothing else")
        if not is_number(timeout) or not timeout > 0.0:
            raise InputError(f"timeout {shown(timeout)} s: must be positive and finite")
        self.timeout = float(timeout)
        self._worlds: list[WorldProcess] = []
        self._stepping: tuple[int, ...] | None = None
        try:
            # All processes are started before waiting for the first, so they import in parallel.
            self._worlds += (WorldProcess(spec) for spec in self.specs)
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        try:
            self._collect(range(len(self.specs)), START_TIME)
        except TrafficError as error:
            raise TrafficError(
                f"{error} (a script that makes worlds does so under "
                '`if __name__ == "__main__":`, since each process reads it again)'
            ) from error

    def __len__(self) -> int:
        """Number of worlds."""
        return len(self.specs)

    @property
    def pids(self) -> tuple[int | None, ...]:
        """Process ids; None for one that has ended."""
        return tuple(world.pid for world in self._worlds)

    def reset(
        self,
        egos: Sequence[EgoState | None] | None = None,
        seeds: Sequence[int] | None = None,
        worlds: Sequence[int] | None = None,
    ) -> tuple[VehicleFrame, ...]:
        """Resets all worlds, or some.

        Args:
          egos: the truck in each of these worlds; None: the mode's own start.
          seeds: one for each of these worlds, kept for later resets; None: the present ones.
          worlds: numbers of the worlds to reset; None: all.

        Returns:
          The vehicles at time zero, in the order of `worlds`.

        Raises:
          InputError: numbers, egos or seeds do not fit; then no world is reset.
          TrafficError, MapError: of the mode's reset, with the world's number.
        """
        asked = self._asked(worlds)
        given_egos = self._egos(egos, asked)
        specs = list(self.specs)
        if seeds is not None:
            given = _one_per_world("seeds", seeds, asked)
            for k, seed in zip(asked, given, strict=True):
                specs[k] = replace(specs[k], seed=whole("seed", seed))
        messages = [
            message_of(("reset", ego, specs[k].seed), f"ego of world {k}")
            for k, ego in zip(asked, given_egos, strict=True)
        ]
        self.specs = tuple(specs)
        self._revive([k for k in asked if not self._worlds[k].alive])
        self._send(asked, messages)
        return self._collect(asked, self.timeout)

    def step(
        self, egos: Sequence[EgoState | None] | None = None, worlds: Sequence[int] | None = None
    ) -> tuple[VehicleFrame, ...]:
        """Advances all worlds, or some, by one step in parallel.

        Args:
          egos: the truck at the end of the step in each of these worlds.
          worlds: numbers of the worlds to step; None: all.

        Returns:
          The vehicles at the end of the step, in the order of `worlds`.

        Raises:
          InputError, TrafficError: of the mode's step, with the world's number.
        """
        self.send_step(egos, worlds)
        return self.receive_step()

    def send_step(
        self, egos: Sequence[EgoState | None] | None = None, worlds: Sequence[int] | None = None
    ) -> None:
        """The first half of `step`: starts the step and returns at once."""
        asked = self._asked(worlds)
        messages = [
            message_of(("step", ego), f"ego of world {k}")
            for k, ego in zip(asked, self._egos(egos, asked), strict=True)
        ]
        self._send(asked, messages)
        self._stepping = asked

    def receive_step(self) -> tuple[VehicleFrame, ...]:
        """The second half of `step`: waits for the vehicles.

        Raises:
          TrafficError: no step was started, or a world failed.
        """
        asked, self._stepping = self._stepping, None
        if asked is None:
            raise TrafficError("no step is under way: send_step() comes first")
        return self._collect(asked, self.timeout)

    def call(
        self, path: str, *arguments: Any, worlds: Sequence[int] | None = None, **options: Any
    ) -> tuple[Any, ...]:
        """Calls a method of the simulations, or reads a value.

        `worlds.call("vehicles.change", "truck", time_headway=3.0)`, `worlds.call("time")`.

        Args:
          path: public name in `PureSim`, with dots.
          *arguments: of the method.
          worlds: numbers of the worlds; None: all.
          **options: of the method.

        Returns:
          The results, in the order of `worlds`; None for a function, which stays in its process.

        Raises:
          InputError: there is no such name, the method refuses its arguments, or the arguments
            cannot be pickled (functions of a script, open files); then no world gets the call.
          TrafficError: the simulation fails, or the result cannot be sent back.
        """
        asked = self._asked(worlds)
        if not isinstance(path, str):
            raise InputError(f"{shown(path)} to call: must be a name, such as 'vehicles.change'")
        message = message_of(("call", path, arguments, options), f"the arguments of {path!r}")
        self._send(asked, [message] * len(asked))
        return self._collect(asked, self.timeout)

    def close(self) -> None:
        """Ends every SUMO and its process; may be called again."""
        worlds, self._worlds = self._worlds, []
        self._stepping = None
        for world in worlds:
            world.ask_to_end()
        for world in worlds:
            world.end(patience=END_TIME)

    def _asked(self, worlds: Sequence[int] | None) -> tuple[int, ...]:
        if not self._worlds:
            raise TrafficError("the traffic worlds are closed; make new ones")
        if self._stepping is not None:
            raise TrafficError("a step is under way: receive_step() comes first")
        if worlds is None:
            return tuple(range(len(self)))
        if isinstance(worlds, str) or not isinstance(worlds, Iterable):
            raise InputError(f"worlds = {shown(worlds)}: must be numbers of worlds, such as [0]")
        asked = tuple(whole("world", k) for k in worlds)
        if len(set(asked)) != len(asked) or not set(asked) <= set(range(len(self))):
            raise InputError(f"worlds {shown(asked)}: each once, of 0 to {len(self) - 1}")
        return asked

    def _egos(
        self, egos: Sequence[EgoState | None] | None, asked: tuple[int, ...]
    ) -> tuple[EgoState | None, ...]:
        if egos is None:
            return (None,) * len(asked)
        given = _one_per_world("egos", egos, asked)
        for k, ego in zip(asked, given, strict=True):
            if not (ego is None or isinstance(ego, EgoState)):
                raise InputError(f"ego of world {k}: {shown(ego)} is neither an EgoState nor None")
        return given

    def _revive(self, dead: Sequence[int]) -> None:
        """Starts the ended processes of worlds again."""
        try:
            for k in dead:
                self._worlds[k].end()
                self._worlds[k] = WorldProcess(self.specs[k])
        except BaseException:
            # Nothing would receive their ready messages.
            for k in dead:
                self._worlds[k].end("was not started; reset it to start it again")
            raise
        self._collect(dead, START_TIME)

    def _send(self, asked: Sequence[int], messages: Sequence[bytes]) -> None:
        """Sends the messages; after an interrupt, ends the worlds that have a message."""
        begun: list[int] = []
        try:
            for k, message in zip(asked, messages, strict=True):
                begun.append(k)
                self._worlds[k].send(message)
        except BaseException:
            for k in begun:
                self._worlds[k].end(INTERRUPTED)
            raise

    def _collect(self, asked: Sequence[int], timeout: float) -> tuple[Any, ...]:
        """The answers of the worlds, in order; raises the first failure at the end."""
        answers: list[Any] = []
        first: Error | None = None
        try:
            for k in asked:
                answer = self._worlds[k].receive(timeout)
                if isinstance(answer, Failure) and first is None:
                    first = answer.raised_by(k)
                answers.append(answer)
        except BaseException:
            # After an interrupt, an old answer would look like the next one.
            for k in asked[len(answers) :]:
                self._worlds[k].end(INTERRUPTED)
            raise
        if first is not None:
            raise first
        return tuple(answers)


def _one_per_world(what: str, given: Any, asked: tuple[int, ...]) -> tuple[Any, ...]:
    if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, Iterable):
        raise InputError(
            f"{what} = {shown(given)}: must be a sequence of {len(asked)}, one per world"
        )
    entries = tuple(given)
    if len(entries) != len(asked):
        raise InputError(f"{len(entries)} {what} for {len(asked)} worlds: one per world is needed")
    return entries


class SeparateTraffic(Mode):
    """`InterSim` or `PureSim` in a process of its own, with bit-identical vehicles.

    Lights and signs stay in the other process, so it is for roads without lights and for traffic
    without events. Scripts need `if __name__ == "__main__":`, see `TrafficWorlds`.

    Args:
      route: the ego's road.
      config: settings.
      seed: of all random numbers.
      mode: "InterSim" or "PureSim".

    Raises:
      InputError: see `WorldSpec`; or the traffic has events or, at the reset, the road has lights.
    """

    def __init__(
        self, route: Route, config: TrafficConfig, seed: int = 0, mode: str = "InterSim"
    ) -> None:
        self._spec = WorldSpec(route, config, seed, mode)
        if config.events:
            raise InputError("traffic in a process of its own can have no events")
        self.route = route
        self._worlds: TrafficWorlds | None = None

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]; TrafficError before the first reset."""
        return float(self._running.call("time")[0])

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Starts again; see the mode's `reset`."""
        if self._worlds is None:
            self._worlds = TrafficWorlds([self._spec])
        vehicles = self._worlds.reset([ego])[0]
        if lights := self._worlds.call("signals.lights")[0]:
            self.close()
            raise InputError(
                f"traffic in a process of its own cannot report lights; the road has {lights[0]!r}"
            )
        return vehicles

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Advances one step; see the mode's `step`."""
        return self._running.step([ego])[0]

    def close(self) -> None:
        """Ends SUMO and its process; may be called again."""
        if self._worlds is not None:
            self._worlds.close()
            self._worlds = None

    @property
    def _running(self) -> TrafficWorlds:
        if self._worlds is None:
            raise TrafficError("the traffic has not been started: call reset() first")
        return self._worlds
