"""Planar motion of the truck in place of MuJoCo's step, compiled (iits_mj/plugin/plant)."""

from __future__ import annotations

import ctypes
import functools
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import mujoco

from iits_mj.core.errors import InputError
from iits_mj.plugin import library

# Limits of the plant's validity, in the order of `Range` in iits_mj/plugin/plant/plant.h.
RANGE = (
    "a wheel has lifted off the road",
    "a coupling has reached its stop in yaw",
    "a unit rolls by more than 0.17 rad",
    "a crest or dip of the road changes the loads by more than a tenth",
    "a unit without slip turns with more than 2 m/s2",
)
_MESSAGE_SIZE = 512
# In the order of `Motion` there.
_MOTIONS = ("yaw-sideslip", "yaw-roll", "kinematic")


@functools.cache
def _functions() -> dict[str, Any]:
    pointer, number = ctypes.c_void_p, ctypes.c_int
    found = {}
    for name, result, arguments in (
        ("create", pointer, (pointer, ctypes.c_char_p, number, ctypes.c_char_p, number)),
        ("delete", None, (pointer,)),
        ("state_size", number, ()),
        ("step", None, (pointer, pointer, pointer, number, number, number, pointer)),
    ):
        function = getattr(library(), f"iits_plant_{name}")
        function.restype, function.argtypes = result, arguments
        found[name] = function
    return found


def reserve_state(spec: mujoco.MjSpec) -> None:
    """Makes room for the plant's state in the user's data of a specification."""
    spec.nuserdata += _functions()["state_size"]()


class Plant:
    """Advances the planar motion of the truck in a model; objects hold constants only.

    The state is in `mjData`: positions, velocities and plugin states as MuJoCo's step leaves them,
    and the last part of `userdata`. A change of positions or velocities from outside counts.

    Args:
      kind: "yaw-sideslip"; "yaw-roll", with the roll of each unit as a state; or "kinematic", whose
        axles do not slip sideways.
      prefix: of the truck's names in the model.
    """

    def __init__(self, kind: str, prefix: str = "") -> None:
        self.kind = kind
        self._prefix = prefix
        self._model: mujoco.MjModel | None = None
        self._handle = 0
        self._delete: Callable[[], object] = lambda: None

    def __getstate__(self) -> dict[str, Any]:
        # A copy reads its own model when it first steps.
        return {"kind": self.kind, "_prefix": self._prefix}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["kind"], state["_prefix"])  # type: ignore[misc]

    def step(
        self, model: mujoco.MjModel, data: Sequence[mujoco.MjData], n: int, *, observe: bool = False
    ) -> list[bool]:
        """Advances each of the data by `n` time steps, and computes their sensors.

        Threads may step different data at the same time.

        Args:
          model: of the truck.
          data: of the model, one for each drive.
          n: time steps, 0 or more.
          observe: computes forces and accelerations of the new state, as `Truck.observe`;
            otherwise the sensors show those of the last step.

        Returns:
          for each, whether its state is finite.

        Raises:
          InputError: the model has no truck of which the plant knows the motion.
        """
        if model is not self._model:
            self._bind(model)
        size = len(data)
        pointers = (ctypes.c_void_p * size)(*[one._address for one in data])
        alive = (ctypes.c_int * size)()
        _functions()["step"](self._handle, model._address, pointers, size, n, observe, alive)
        return [bool(one) for one in alive]

    def left_range(self, data: mujoco.MjData) -> tuple[str, ...]:
        """Returns the limits of validity that were exceeded since the last reset."""
        flags = int(data.userdata[-1])
        return tuple(text for bit, text in enumerate(RANGE) if flags >> bit & 1)

    def _bind(self, model: mujoco.MjModel) -> None:
        functions = _functions()
        message = ctypes.create_string_buffer(_MESSAGE_SIZE)
        handle = functions["create"](
            model._address, self._prefix.encode(), _MOTIONS.index(self.kind), message, _MESSAGE_SIZE
        )
        if not handle:
            raise InputError(f"plant {self.kind}: {message.value.decode()}")
        self._delete()
        self._delete = weakref.finalize(self, functions["delete"], handle)
        self._model, self._handle = model, handle
