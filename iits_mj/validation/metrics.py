"""How well one time history follows another."""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray


def fit(signal: FloatArray, reference: FloatArray) -> float:
    """`100 (1 - |y - y_ref| / |y_ref - mean(y_ref)|)` [%], NaN for a constant reference."""
    spread = np.linalg.norm(reference - reference.mean())
    if spread == 0.0:
        return float("nan")
    return float(100.0 * (1.0 - np.linalg.norm(signal - reference) / spread))


def peak_ratio(signal: FloatArray, reference: FloatArray) -> float:
    """Greatest magnitude over the reference's."""
    return float(np.max(np.abs(signal)) / np.max(np.abs(reference)))


def harmonic(time: FloatArray, signal: FloatArray, frequencies: FloatArray) -> FloatArray:
    """Complex amplitudes (k,) of a signal (n,) at frequencies [Hz] (k,), by least squares.

    A constant and a drift are taken out. The amplitude `c` means `Re(c exp(2 pi i f t))`.
    """
    phase = 2.0 * np.pi * np.outer(time, frequencies)
    basis = np.hstack([np.cos(phase), np.sin(phase), np.ones((len(time), 1)), time[:, None]])
    found = np.linalg.lstsq(basis, signal, rcond=None)[0]
    count = len(frequencies)
    return np.asarray(found[:count] - 1j * found[count : 2 * count])
