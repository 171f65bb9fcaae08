"""Pickles `mjModel` and `mjData` of models with engine plugins.

MuJoCo's own pickling of `mjData` copies the pointers to the plugin's objects, and the process that
loads the copy crashes. Here data are stored as their integration state, and made again from the
model: `copy`, `pickle` and spawned processes continue to the bit. Only data that MuJoCo computes
from that state (contacts, forces) are those of `mj_forward`; sensors keep their last reading.
"""

from __future__ import annotations

import copyreg
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def enable() -> None:
    """Makes `pickle` use this module for models with plugins, in this process."""
    copyreg.pickle(mujoco.MjModel, _reduce_model)
    copyreg.pickle(mujoco.MjData, _reduce_data)


def _reduce_model(model: mujoco.MjModel) -> tuple[Any, ...]:
    if not model.nplugin:
        return model.__reduce_ex__(4)
    return _load_model, (model.__getstate__(),)


def _load_model(stored: bytes) -> mujoco.MjModel:
    # The process may not have the plugin yet, and the model cannot be loaded without it.
    from iits_mj.plugin import register

    register()
    model = mujoco.MjModel.__new__(mujoco.MjModel)
    model.__setstate__(stored)
    return model


def _reduce_data(data: mujoco.MjData) -> tuple[Any, ...]:
    model = data.model
    if not model.nplugin:
        return data.__reduce_ex__(4)
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return _load_data, (model, state, data.sensordata.copy())


def _load_data(model: mujoco.MjModel, state: FloatArray, sensors: FloatArray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, _STATE)
    mujoco.mj_forward(model, data)
    # mj_forward replaces the solver's first guess, which is part of the state.
    mujoco.mj_setState(model, data, state, _STATE)
    data.sensordata[:] = sensors
    return data
