"""Many traffic simulations at once: each in a process of its own, because libsumo holds only one.

    with TrafficWorlds([WorldSpec(route, config, seed=k) for k in range(8)]) as worlds:
        frames = worlds.reset(egos)
        frames = worlds.step(egos)      # all 0.1 s on, at the same time

A world gives bit for bit what the same mode gives in this process. The processes are started anew
("spawn"), so a script that makes worlds needs the usual `if __name__ == "__main__":`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from iits_mj.closing import Closing
from iits_mj.errors import Error, InputError, TrafficError
from iits_mj.messages import EgoState
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.modes.sumo_modes import InterSim, PureSim
from traffic_bridge.modes.world_process import END_TIME, Failure, WorldProcess

MODES: dict[str, type[PureSim]] = {"InterSim": InterSim, "PureSim": PureSim}
START_TIME = 120.0  # [s] for a process to import what it needs


@dataclass(frozen=True)
class WorldSpec:
    """One world: where, what traffic, which seed.

    Attributes:
      route: the ego's road.
      config: settings of the traffic.
      seed: of everything random, 0 to 2^31 - 1; `TrafficWorlds.reset` may give another.
      mode: "InterSim" or "PureSim".

    Raises:
      InputError: no route or configuration, an unknown mode, or a seed that is not usable.
    """

    route: Route
    config: TrafficConfig = field(default_factory=TrafficConfig)
    seed: int = 0
    mode: str = "InterSim"

    def __post_init__(self) -> None:
        """Checks what a process would find out late."""
        if not isinstance(self.route, Route) or not isinstance(self.config, TrafficConfig):
            raise InputError(
                f"a world needs a Route and a TrafficConfig, not {type(self.route).__name__} and "
                f"{type(self.config).__name__}"
            )
        if self.mode not in MODES:
            raise InputError(f"mode {self.mode!r} of a world: allowed are {', '.join(MODES)}")
        self()

    def __call__(self) -> PureSim:
        """The simulation, not begun yet."""
        return MODES[self.mode](self.route, self.config, self.seed)


class TrafficWorlds(Closing):
    """N traffic simulations side by side, stepped together.

    Every method waits for all the worlds that it asks. When one of them fails, the others have done
    what was asked; the first failure is raised with the number of its world. A failed world is
    used again after a reset, also when its process had died.

    Args:
      specs: one a world.
      timeout: a world that gives no answer for so long is taken for hung and ended [s].

    Attributes:
      specs: one a world, with the seeds now in use.
      timeout: as given.

    Raises:
      InputError: no spec, or a value that is not usable.
      TrafficError: a process cannot be started.
    """

    def __init__(self, specs: Iterable[WorldSpec], timeout: float = 120.0) -> None:
        self.specs = tuple(specs) if isinstance(specs, Iterable) else ()
        if not self.specs or not all(isinstance(spec, WorldSpec) for spec in self.specs):
            raise InputError("TrafficWorlds needs at least one WorldSpec, and nothing else")
        if not (isinstance(timeout, (int, float)) and math.isfinite(timeout) and timeout > 0.0):
            raise InputError(f"timeout {timeout!r} s: must be positive and finite")
        self.timeout = timeout
        self._worlds: list[WorldProcess] = []
        self._stepping: tuple[int, ...] | None = None
        try:
            # All are started before the first is waited for: they import side by side.
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
        """Numbers of the processes; None for one that has ended."""
        return tuple(world.pid for world in self._worlds)

    def reset(
        self,
        egos: Sequence[EgoState | None] | None = None,
        seeds: Sequence[int] | None = None,
        worlds: Sequence[int] | None = None,
    ) -> tuple[VehicleFrame, ...]:
        """Begins anew, in all worlds or in some.

        Args:
          egos: where the truck stands, one an asked world; None for the mode's own beginning.
          seeds: one an asked world, kept until another is given; None for those they have.
          worlds: numbers of the worlds to reset; None for all.

        Returns:
          The vehicles at time zero, in the order of `worlds`.

        Raises:
          InputError: numbers, egos or seeds do not fit; nothing has been reset then.
          TrafficError, MapError: as of the mode's reset, with the world's number.
        """
        asked = self._asked(worlds)
        given_egos = self._egos(egos, asked)
        if seeds is not None:
            self._reseed(asked, seeds)
        dead = [k for k in asked if not self._worlds[k].alive]
        for k in dead:
            self._worlds[k].end()
            self._worlds[k] = WorldProcess(self.specs[k])
        self._collect(dead, START_TIME)
        for k, ego in zip(asked, given_egos, strict=True):
            self._worlds[k].send(("reset", ego, self.specs[k].seed))
        return self._collect(asked, self.timeout)

    def step(
        self, egos: Sequence[EgoState | None] | None = None, worlds: Sequence[int] | None = None
    ) -> tuple[VehicleFrame, ...]:
        """Advances all worlds, or some, by one step at the same time.

        Args:
          egos: the truck at the end of the step, one an asked world.
          worlds: numbers of the worlds to step; None for all.

        Returns:
          The vehicles at the end of the step, in the order of `worlds`.

        Raises:
          InputError, TrafficError: as of the mode's step, with the world's number.
        """
        self.send_step(egos, worlds)
        return self.receive_step()

    def send_step(
        self, egos: Sequence[EgoState | None] | None = None, worlds: Sequence[int] | None = None
    ) -> None:
        """The first half of `step`: the worlds begin to work, and the caller may do so, too."""
        asked = self._asked(worlds)
        for k, ego in zip(asked, self._egos(egos, asked), strict=True):
            self._worlds[k].send(("step", ego))
        self._stepping = asked

    def receive_step(self) -> tuple[VehicleFrame, ...]:
        """The second half of `step`: waits for the vehicles.

        Raises:
          TrafficError: no step was begun, or a world failed.
        """
        asked, self._stepping = self._stepping, None
        if asked is None:
            raise TrafficError("no step is under way: send_step() comes first")
        return self._collect(asked, self.timeout)

    def call(
        self, path: str, *arguments: Any, worlds: Sequence[int] | None = None, **options: Any
    ) -> tuple[Any, ...]:
        """Calls a method of the simulations, or reads a value of them.

        `worlds.call("vehicles.change", "truck", time_headway=3.0)`, `worlds.call("time")`.

        Args:
          path: public name in `PureSim`, with dots.
          *arguments: of the method.
          worlds: numbers of the worlds to ask; None for all.
          **options: of the method.

        Returns:
          The answers, in the order of `worlds`; None for a function, which stays in its process.

        Raises:
          InputError: there is no such name, or the method refuses its arguments.
          TrafficError: the simulation fails, or the answer cannot leave its process.
        """
        asked = self._asked(worlds)
        for k in asked:
            self._worlds[k].send(("call", path, arguments, options))
        return self._collect(asked, self.timeout)

    def close(self) -> None:
        """Ends every SUMO and its process; may be called again."""
        worlds, self._worlds = self._worlds, []
        self._stepping = None
        for world in worlds:
            world.ask_to_end()
        for world in worlds:
            world.end(patience=END_TIME)

    # Inside ------------------------------------------------------------------------------------

    def _asked(self, worlds: Sequence[int] | None) -> tuple[int, ...]:
        if not self._worlds:
            raise TrafficError("the traffic worlds are closed; make new ones")
        if self._stepping is not None:
            raise TrafficError("a step is under way: receive_step() comes first")
        if worlds is None:
            return tuple(range(len(self)))
        asked = tuple(_whole("world", k) for k in worlds)
        if len(set(asked)) != len(asked) or not set(asked) <= set(range(len(self))):
            raise InputError(f"worlds {worlds!r}: each once, of 0 to {len(self) - 1}")
        return asked

    def _egos(
        self, egos: Sequence[EgoState | None] | None, asked: tuple[int, ...]
    ) -> Sequence[EgoState | None]:
        if egos is None:
            return [None] * len(asked)
        if len(egos) != len(asked):
            raise InputError(f"{len(egos)} egos for {len(asked)} worlds: one a world is needed")
        for k, ego in zip(asked, egos, strict=True):
            if not (ego is None or isinstance(ego, EgoState)):
                raise InputError(f"ego of world {k}: {ego!r} is neither an EgoState nor None")
        return egos

    def _reseed(self, asked: tuple[int, ...], seeds: Sequence[int]) -> None:
        if len(seeds) != len(asked):
            raise InputError(f"{len(seeds)} seeds for {len(asked)} worlds: one a world is needed")
        specs = list(self.specs)
        for k, seed in zip(asked, seeds, strict=True):
            specs[k] = replace(specs[k], seed=_whole("seed", seed))
        self.specs = tuple(specs)

    def _collect(self, asked: Sequence[int], timeout: float) -> tuple[Any, ...]:
        """One answer of each asked world, in order; the first failure is raised at the end."""
        answers: list[Any] = []
        first: Error | None = None
        try:
            for k in asked:
                answer = self._worlds[k].receive(timeout)
                if isinstance(answer, Failure) and first is None:
                    first = answer.raised_by(k)
                answers.append(answer)
        except BaseException:
            # Interrupted: an answer that is still on its way would be taken for that to come.
            for k in asked[len(answers) :]:
                self._worlds[k].end("was ended by an interrupt; reset it to start it anew")
            raise
        if first is not None:
            raise first
        return tuple(answers)


def _whole(name: str, value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise InputError(f"{name} {value!r}: must be a whole number") from None
