"""The order of calls in the lock-step of a truck, a driver and an observer."""

from __future__ import annotations

import dataclasses

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, VehicleCommand
from iits_mj.simulation.lock_step import LockStep, Observer


class Calls(Observer):
    """Truck, driver, source of scenes and observer in one, which record their calls."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.time = 0.0
        self.seen: list[EgoState] = []

    def _note(self, name: str) -> None:
        self.names.append(name)

    def observe(self, *_: object) -> EgoState:
        self._note("observe")
        return EgoState(time=self.time)

    def scene(self, ego: EgoState) -> Scene:
        self._note("scene")
        self.seen.append(ego)
        return Scene(ego.time, ego)

    def plan(self, scene: Scene) -> str:
        self._note("plan")
        return "plan"

    def planned(self, scene: Scene, trajectory: object) -> None:
        assert trajectory == "plan"
        self._note("planned")

    def control(self, ego: EgoState) -> VehicleCommand:
        self._note("control")
        self.seen.append(ego)
        return VehicleCommand(accelerator_pedal=0.5)

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        assert wanted is obeyed
        self._note("commanded")

    def command(self, command: VehicleCommand) -> None:
        self._note("command")

    def step(self, n: int) -> None:
        self._note(f"step {n}")
        self.time += 0.002 * n


PLAN = ["scene", "plan", "planned"]
ACT = ["control", "commanded", "command", "step 10"]


def lock_step(calls: Calls, timestep: float = 0.002) -> LockStep:
    return LockStep(calls, calls, calls.scene, [calls], timestep=timestep)  # type: ignore[arg-type]


def test_a_plan_is_made_every_fifth_control_step_before_the_command() -> None:
    calls = Calls()
    driven = lock_step(calls)
    driven.advance(0.2)
    cycle = ["observe", *PLAN, *ACT, *(["observe", *ACT] * 4)]
    assert calls.names == cycle * 2
    assert driven.time == pytest.approx(0.2)


def test_plan_and_command_answer_the_same_observation() -> None:
    calls = Calls()
    lock_step(calls).advance(0.02)
    assert calls.seen[0] is calls.seen[1]


def test_a_state_that_ends_the_drive_is_the_last_one_commanded() -> None:
    calls = Calls()
    driven = lock_step(calls)
    assert driven.advance(1.0, lambda ego: ego.time > 0.05)
    assert calls.names.count("control") == 4
    assert not lock_step(Calls()).advance(0.1, lambda ego: ego.time > 0.5)


def test_a_time_step_that_does_not_divide_20_ms_is_refused() -> None:
    with pytest.raises(InputError, match="must be a multiple"):
        lock_step(Calls(), timestep=0.003)


def test_frames_are_encoded_only_for_observers_that_read_the_bus() -> None:
    frames = []

    class Reader(Observer):
        reads_bus = True

        def sent(self, frame: object) -> None:
            frames.append(frame)

    calls = Calls()
    driven = lock_step(calls)
    driven.observers = (*driven.observers, Reader())
    driven.advance(0.02)
    assert len(frames) == 5
    assert all(dataclasses.is_dataclass(frame) for frame in frames)
