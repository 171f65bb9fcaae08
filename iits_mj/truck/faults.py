"""Failures of a truck's parts, for tests of what drives it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range, one_of
from iits_mj.core.errors import InputError

if TYPE_CHECKING:
    from iits_mj.truck.truck import Truck

CIRCUITS = ("front", "drive", "trailer")
SIDES = ("left", "right")
# Layout of `BrakeFaults`, the last part of the air brake's state (iits_mj/plugin/laws/air_brake.h).
WHEELS_MAX = 32
_LEAK, _STUCK = 0, len(CIRCUITS)
_SHOWN, _DOUBT = _STUCK + WHEELS_MAX, _STUCK + 2 * WHEELS_MAX
_SIZE = _STUCK + 3 * WHEELS_MAX
# A sensor of doubtful speed is not used by ABS after this time [s]; also in air_brake.h.
DOUBT_MAX = 2.0
LEAK_MAX = 100.0  # [1/s]


class Faults:
    """Makes parts of a truck fail: `truck.faults`.

    A fault is a number in `data.plugin_state`, so copies, roll-outs and threads keep it. It lasts
    until `clear` or a reset of the data.

    Args:
      truck: whose parts fail.

    Attributes:
      wheels: names of the wheel ends, from front to rear, left before right.
    """

    def __init__(self, truck: Truck) -> None:
        model, prefix, axles = truck.model, truck.prefix, truck.parameters.axles
        self.wheels = tuple(f"{axle.name}_{side}" for axle in axles for side in SIDES)
        self._truck = truck
        brake = model.actuator_plugin[model.actuator(f"{prefix}xbr_demand").id]
        self._first = int(model.plugin_stateadr[brake] + model.plugin_statenum[brake]) - _SIZE
        self._punctures = [_puncture(model, f"{prefix}{name}_wheel") for name in self.wheels]

    @property
    def _state(self) -> FloatArray:
        state: FloatArray = self._truck.data.plugin_state
        return state

    @property
    def _brake(self) -> FloatArray:
        return self._state[self._first : self._first + _SIZE]

    def stick_speed_sensor(self, wheel: str, speed: float = 0.0) -> None:
        """Makes a wheel-speed sensor show the same speed from now on.

        Args:
          wheel: one of `wheels`.
          speed: shown [rad/s]; 0 is a broken wire.

        Raises:
          InputError: there is no such wheel, or the speed is not from 0 to 1000 rad/s.
        """
        index, shown = self._index(wheel), in_range("speed", speed, 0.0, 1e3, "rad/s")
        self._brake[_STUCK + index], self._brake[_SHOWN + index] = 1.0, shown

    def leak(self, circuit: str, rate: float = 2.0) -> None:
        """Lets the air out of a brake circuit.

        The circuit "trailer" is also what a torn supply hose empties: the trailer's spring brakes
        apply.

        Args:
          circuit: "front", "drive" or "trailer".
          rate: share of the air that leaves in a second [1/s]; 2 is a torn hose, 0 none.

        Raises:
          InputError: there is no such circuit, or the rate is not from 0 to 100 1/s.
        """
        number = CIRCUITS.index(one_of("circuit", circuit, CIRCUITS))
        self._brake[_LEAK + number] = in_range("rate", rate, 0.0, LEAK_MAX, "1/s")

    def puncture(self, wheel: str, lost: float = 1.0) -> None:
        """Takes the pressure out of a tire, of one of the two at a wheel end with twin tires.

        Args:
          wheel: one of `wheels`.
          lost: share of the pressure, 0 to 1.

        Raises:
          InputError: there is no such wheel, or the share is out of range.
        """
        place = self._punctures[self._index(wheel)]
        self._state[place] = in_range("lost", lost, 0.0, 1.0)

    def clear(self) -> None:
        """Repairs everything; an emptied circuit fills again by the compressor."""
        self._brake[:] = 0.0
        self._state[self._punctures] = 0.0

    @property
    def abs_operational(self) -> bool:
        """False while ABS does not use a wheel's sensor, because its speed is not plausible."""
        return not bool((self._brake[_DOUBT:] > DOUBT_MAX).any())

    def _index(self, wheel: str) -> int:
        if wheel not in self.wheels:
            raise InputError(f"wheel {wheel!r} is not known; use one of: {', '.join(self.wheels)}")
        return self.wheels.index(wheel)


def _puncture(model: mujoco.MjModel, wheel: str) -> int:
    """Index of a tire's lost pressure in `plugin_state`: the last number of the wheel's state."""
    body = model.body(wheel).id
    instance = model.body_plugin[body]
    same = [int(b) for b in range(model.nbody) if model.body_plugin[b] == instance]
    size = int(model.plugin_statenum[instance]) // len(same)
    return int(model.plugin_stateadr[instance]) + (same.index(body) + 1) * size - 1
