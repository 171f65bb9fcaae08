"""`Physics` of the highway task: a step of it is the whole truck's, with stack and traffic."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from dm_control.mujoco import wrapper
from dm_control.rl import control

from controllers.decision.trip import TripConfig
from iits_mj.errors import Error, InputError
from iits_mj.messages import Decision
from iits_mj.simulation.loop import CYCLE_PERIOD, Simulation
from iits_mj.simulation.truck_world import TruckWorld
from iits_mj.suite.physics import Physics


class HighwayPhysics(Physics):
    """The truck, its stack and SUMO's traffic behind the interface of a `Physics`.

    `step` advances all of them, in whole cycles of 100 ms. The truck and its payload stay, the
    traffic is another one in every episode. Made by `from_world`.
    """

    world: TruckWorld
    trip: TripConfig

    @classmethod
    def from_world(cls, world: TruckWorld, trip: TripConfig) -> HighwayPhysics:
        """Begins a first episode, whose model stays."""
        world.reset(np.random.default_rng(0), trip)
        truck = _running(world).truck
        physics: HighwayPhysics = cls.from_model(wrapper.MjModel(truck.model))
        physics.world, physics.trip = world, trip
        physics._take_over()
        return physics

    @property
    def simulation(self) -> Simulation:
        """Truck, stack and traffic of the episode."""
        return _running(self.world)

    def begin(self, generator: np.random.Generator) -> None:
        """Another traffic; the truck is back at its start."""
        self.world.reset(generator, self.trip)
        self._reload_from_model(wrapper.MjModel(_running(self.world).truck.model))
        self._take_over()

    def step(self, nstep: int = 1) -> None:
        """Advances by whole cycles of 100 ms; a trip that is over stands still.

        Raises:
          InputError: `nstep` is no whole number of cycles.
        """
        cycles = nstep * self.timestep() / CYCLE_PERIOD
        if abs(cycles - round(cycles)) > 1e-6:
            raise InputError(
                f"{nstep} steps are {nstep * self.timestep():g} s: use cycles of 0.1 s"
            )
        for _ in range(round(cycles)):
            if not self.over:
                self.simulation.cycle()

    @property
    def over(self) -> bool:
        """The road or the time is at its end, or the truck has failed."""
        return bool(self.simulation.ended)

    def decide(self, decision: Decision) -> None:
        """What the stack is told when it next asks for a decision."""
        self.world.tell(decision)

    def copy(self, share_model: bool = False) -> Any:
        """Not possible.

        Raises:
          Error: always: SUMO's state cannot be copied.
        """
        del share_model
        raise Error("the highway's physics cannot be copied: its traffic runs in SUMO")

    def free(self) -> None:
        """Ends SUMO, too."""
        self.world.close()
        super().free()

    def _take_over(self) -> None:
        """Lets the simulation's truck live in the data of this physics."""
        truck = self.simulation.truck
        mujoco.mj_copyData(self.data.ptr, self.model.ptr, truck.data)
        self._bind(truck)


class HighwayEnvironment(control.Environment):
    """An environment whose `close` ends SUMO; dm_control's own does nothing."""

    def close(self) -> None:
        """Ends SUMO; the environment cannot be used after that."""
        self.physics.free()


def _running(world: TruckWorld) -> Simulation:
    if world.simulation is None:
        raise InputError("the trip has not begun: call reset first")
    return world.simulation
