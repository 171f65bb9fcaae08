"""Recorded drives made by hand, for the measures that are taken of them."""

import numpy as np

from iits_mj.validation.harness.recorder import PERIOD
from iits_mj.validation.longitudinal.runs import Run


def drive(duration=10.0, **columns):
    """A run of this length [s]; columns that are not given are zero, the speed is 20 m/s."""
    time = np.arange(round(duration / PERIOD) + 1) * PERIOD
    empty = {
        name: np.zeros_like(time)
        for name in Run.__dataclass_fields__
        if name not in ("wheel_slips", "wheel_pressures", "extra")
    }
    wide = {
        "wheel_slips": np.zeros((len(time), 12)),
        "wheel_pressures": np.zeros((len(time), 12)),
    }
    start = {"time": time, "speed": np.full_like(time, 20.0)}
    given = {name: value(time) if callable(value) else value for name, value in columns.items()}
    return Run(**{**empty, **wide, **start, **given})
