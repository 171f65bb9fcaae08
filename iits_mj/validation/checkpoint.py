"""Takes the whole state of the truck and puts it back: several tries from one instant."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.truck import Truck

_EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION


def state_of(truck: Truck) -> NDArray[np.float64]:
    """Everything that the next step depends on, plugin state and controls included, shape (n,)."""
    state = np.empty(mujoco.mj_stateSize(truck.model, _EVERYTHING))
    mujoco.mj_getState(truck.model, truck.data, state, _EVERYTHING)
    return state


def restore(truck: Truck, state: NDArray[np.float64]) -> None:
    """Puts a state of the same truck back."""
    mujoco.mj_setState(truck.model, truck.data, state, _EVERYTHING)
    mujoco.mj_forward(truck.model, truck.data)
