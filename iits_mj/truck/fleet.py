"""Several trucks, equal or not, on one road in one MuJoCo model: platoons, collisions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco

from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.timing import TIMESTEP
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.plugin import register
from iits_mj.road import Route
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.truck import Truck, bring_up_to_date, compile_scene

# Each truck has its own contact bit above those of ground, trucks and traffic.
_FIRST_BIT = 3
TRUCKS_MAX = 31 - _FIRST_BIT


class TruckFleet:
    """Trucks that share a road and a clock and collide with each other.

    All names of truck k begin with `prefix(k)`: body `truck0/tractor`, sensor `truck1/speed`.
    `trucks[k]` commands and reads one truck; `reset` and `step` act on all.

    Args:
      trucks: with common model and data; use `load` to make them.

    Attributes:
      trucks: in the order of the payloads; model, data: of the scene; route: the road.
    """

    def __init__(self, trucks: Sequence[Truck]) -> None:
        self.trucks = tuple(trucks)
        first = self.trucks[0]
        self.model, self.data, self.route = first.model, first.data, first.route

    @classmethod
    def load(
        cls,
        payloads: Sequence[float | None],
        *,
        route: Route,
        truck: AnyTruck | Sequence[AnyTruck] | None = None,
        timestep: float = TIMESTEP,
        visuals: bool = True,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> TruckFleet:
        """Builds the trucks on their road and compiles them.

        Args:
          payloads: of each truck [kg], 1 to 28 of them; None: the truck's greatest.
          route: the road.
          truck: of all, or one for each payload; see `Truck.load`.
          timestep: of the physics [s], 0.0005 to 0.005.
          visuals: adds the visual geoms.
          edit_spec: called with the specification before it is compiled.

        Raises:
          InputError: number of trucks, a truck, a payload or the time step is not allowed.
          PluginError: the engine plugin is missing.
        """
        in_range("number of trucks", len(payloads), 1, TRUCKS_MAX)
        register()
        each = [TruckParameters.load(one) for one in trucks_of(truck, len(payloads))]
        loads = [p.check_payload(load) for p, load in zip(each, payloads, strict=True)]
        spec = mujoco.MjSpec()
        for number, (parameters, payload) in enumerate(zip(each, loads, strict=True)):
            part = truck_spec(parameters, payload, visuals=visuals)
            _set_contacts(part, number, len(loads))
            if number == 0:
                spec.option = part.option
            spec.attach(part, prefix=prefix(number), frame=spec.worldbody.add_frame())
        model = compile_scene(spec, route, timestep, visuals=visuals, edit_spec=edit_spec)
        data = mujoco.MjData(model)
        fleet = cls(
            [
                Truck(model, parameters, load, route, prefix=prefix(number), data=data)
                for number, (parameters, load) in enumerate(zip(each, loads, strict=True))
            ]
        )
        length = max(one.footprint.length for one in fleet.trucks)
        fleet.reset(
            [TruckPlacement(station=20.0 + 2.0 * length * k) for k in range(len(loads))][::-1]
        )
        return fleet

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self.data.time)

    def reset(self, places: Sequence[TruckPlacement]) -> tuple[EgoState, ...]:
        """Resets the scene with each truck at its place.

        Raises:
          InputError: the number of places is not that of the trucks.
        """
        if len(places) != len(self.trucks):
            raise InputError(f"reset: {len(places)} places for {len(self.trucks)} trucks")
        mujoco.mj_resetData(self.model, self.data)
        for truck, place in zip(self.trucks, places, strict=True):
            truck.place(place)
        mujoco.mj_forward(self.model, self.data)
        return self.observe()

    def step(self, n: int = 1) -> None:
        """Advances all trucks by `n` time steps.

        Raises:
          Error: the simulation diverged.
        """
        self.trucks[0].step(n)

    def observe(self) -> tuple[EgoState, ...]:
        """Returns the current state of each truck."""
        bring_up_to_date(self.model, self.data)
        return tuple(truck.state() for truck in self.trucks)

    def touching(self) -> frozenset[tuple[int, int]]:
        """Returns pairs of trucks whose hulls touched in the last step, the lower number first."""
        owner = [self._owner(self.model.geom(g).name) for g in range(self.model.ngeom)]
        pairs = set()
        for contact in self.data.contact:
            one, other = (owner[int(geom)] for geom in contact.geom)
            if one is not None and other is not None and one != other:
                pairs.add((min(one, other), max(one, other)))
        return frozenset(pairs)

    def _owner(self, name: str) -> int | None:
        """Number of the truck that an element of the model belongs to."""
        return next(
            (k for k, truck in enumerate(self.trucks) if name.startswith(truck.prefix)), None
        )


def trucks_of(truck: AnyTruck | Sequence[AnyTruck] | None, count: int) -> Sequence[AnyTruck | None]:
    """Returns a truck for each of `count` places, from one for all or one for each.

    Raises:
      InputError: there are several, but not `count`.
    """
    if isinstance(truck, str) or not isinstance(truck, Sequence):
        return [truck] * count
    if len(truck) != count:
        raise InputError(f"{len(truck)} trucks for {count} places: name one, or one for each place")
    return truck


def prefix(number: int) -> str:
    """Returns the prefix of the names of a truck of a fleet."""
    return f"truck{number}/"


def _set_contacts(spec: mujoco.MjSpec, number: int, count: int) -> None:
    """Enables contacts between the hulls of different trucks."""
    bits = [1 << (_FIRST_BIT + k) for k in range(count)]
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype |= bits[number]
            geom.conaffinity |= sum(bits) - bits[number]
