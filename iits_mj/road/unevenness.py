"""Unevenness of the road surface below the tires: ISO 8608 classes, potholes, expansion joints.

The random part is a surface, so that every lane has its own wheel tracks. A track has the
displacement spectrum of ISO 8608, `G(n) = G(0.1) (n / 0.1)^-2`, and two tracks have the coherence
of an isotropic surface (Kamash and Robson, The application of isotropy in road surface modelling,
J. Sound Vib. 57, 1978).

A tire averages the heights over its contact (Sayers, Gillespie, Queiroz, World Bank Technical Paper
45, 1986, which takes 0.25 m). The surface is therefore filtered once, and the tires of the physics
read its heights at their contact's middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range, is_whole, one_of, shown
from iits_mj.core.errors import InputError

# G(0.1) at the middle of each class of ISO 8608 [m3]; a class spans half to double of it.
CLASSES = {"smooth": 0.0, "A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}
# Place of the spectrum's reference, and band of the standard [1/m].
REFERENCE, BAND = 0.1, (0.011, 2.83)
# The surface repeats after this length and width, and has heights at these steps [m].
LENGTH, WIDTH, ALONG, ACROSS = 2048.0, 16.0, 0.125, 0.25
ROWS, COLUMNS = round(LENGTH / ALONG), round(WIDTH / ACROSS)
# Contact of a truck's tire [m]: length `2 sqrt(R d)` at radius R and deflection d (Rill, Road
# Vehicle Dynamics, 2011, section 3.3), 0.24 m for 315/80 R 22.5 at 35 kN, and width.
CONTACT_LENGTH, CONTACT_WIDTH = 0.24, 0.3
# Potholes of moderate severity (FHWA-HRT-13-092, Distress Identification Manual, 2014): depth and
# diameter, drawn evenly; width of the flank, estimated [m].
POTHOLE_DEPTH, POTHOLE_DIAMETER, _FLANK = (0.025, 0.05), (0.3, 0.9), 0.1
# Widest gap of a joint with one seal (EAD 120109, 2019); depth to the seal, estimated [m].
JOINT_GAP, JOINT_DEPTH = 0.08, 0.02
# Lane of the potholes' number per kilometer [m].
_LANE = 3.5


def spectrum(frequency: FloatArray, reference: float, band: tuple[float, float]) -> FloatArray:
    """Returns the one-sided displacement spectrum of ISO 8608 [m3], zero outside a band.

    Args:
      frequency: spatial [1/m], shape (n,).
      reference: G(0.1) [m3].
      band: first and last frequency [1/m].
    """
    inside = (frequency >= band[0]) & (frequency <= band[1])
    kept = np.where(inside, frequency, 1.0)
    return np.where(inside, reference * (kept / REFERENCE) ** -2.0, 0.0)


def random_track(
    density: FloatArray, count: int, step: float, random: np.random.Generator
) -> FloatArray:
    """Returns heights (count,) [m] with a one-sided spectrum [m3] and random phases.

    Args:
      density: at the frequencies of `numpy.fft.rfftfreq(count, step)`.
      count: of the heights.
      step: of the heights [m].
      random: draws the phases.
    """
    amplitude = np.sqrt(2.0 * density / (count * step))
    phase = np.exp(2j * np.pi * random.random(len(density)))
    return np.fft.irfft(0.5 * count * amplitude * phase, count)


def random_surface(reference: float, random: np.random.Generator) -> FloatArray:
    """Returns an isotropic surface, shape (ROWS, COLUMNS) [m], as a sum of waves across the road.

    Each wave has its own random tracks. An isotropic surface whose tracks have a spectrum n^-2 has
    the density (n^2 + m^2)^(-3/2) over the frequencies n along and m across; the integral over an
    interval of m is a wave's share of the spectrum.
    """
    frequency = np.asarray(np.fft.rfftfreq(ROWS, ALONG), dtype=float)
    density = spectrum(frequency, reference, BAND)
    n = np.maximum(frequency, BAND[0])
    waves = COLUMNS // 2
    edges = (np.arange(waves + 1) - 0.5)[:, None] / WIDTH
    shares = np.diff(edges / np.hypot(n, edges), axis=0)
    shares[0] *= 0.5
    shares /= shares.sum(axis=0)
    heights = np.zeros((ROWS, COLUMNS))
    for wave, share in enumerate(shares):
        angle = 2.0 * np.pi * wave * np.arange(COLUMNS) / COLUMNS
        for across in (np.cos(angle), np.sin(angle)) if wave else (np.ones(COLUMNS),):
            heights += np.outer(random_track(density * share, ROWS, ALONG, random), across)
    return heights


def through_tire(heights: FloatArray) -> FloatArray:
    """Returns heights (ROWS, COLUMNS) as means over the tire's contact."""
    along = np.sinc(np.fft.fftfreq(ROWS, ALONG) * CONTACT_LENGTH)
    across = np.sinc(np.fft.rfftfreq(COLUMNS, ACROSS) * CONTACT_WIDTH)
    return np.fft.irfft2(np.fft.rfft2(heights) * np.outer(along, across), heights.shape)


@dataclass(frozen=True)
class Unevenness:
    """What makes a road uneven; it repeats after 2 048 m of the road, and 16 m across.

    Attributes:
      roughness: of `CLASSES`.
      potholes: per kilometer of a lane 3.5 m wide, 25 to 50 mm deep; at most 200.
      joint_spacing: distance of expansion joints across the road [m], 2 to 1000; None: no joints.
        A whole number of joints fits into 2 048 m: the spacing changes a little.
      seed: of the random part and of the potholes' places.

    Raises:
      InputError: a value is not allowed.
    """

    roughness: str = "smooth"
    potholes: float = 0.0
    joint_spacing: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        one_of("roughness", self.roughness, tuple(CLASSES))
        in_range("potholes", self.potholes, 0.0, 200.0, "per km")
        if self.joint_spacing is not None:
            in_range("joint-spacing", self.joint_spacing, 2.0, 1000.0, "m")
        if not is_whole(self.seed) or self.seed < 0:
            raise InputError(f"seed of the unevenness {shown(self.seed)}: use 0 or more")

    def __bool__(self) -> bool:
        """Whether the road is not smooth."""
        return self != Unevenness(seed=self.seed)

    def __str__(self) -> str:
        """The unevenness in words."""
        parts = ["smooth" if self.roughness == "smooth" else f"ISO 8608 class {self.roughness}"]
        if self.potholes:
            parts.append(f"{self.potholes:g} potholes per km of lane")
        if self._joints:
            parts.append(f"expansion joints every {LENGTH / self._joints:.4g} m")
        return ", ".join(parts) + (f", road seed {self.seed}" if self else "")

    @property
    def _joints(self) -> int:
        return 0 if self.joint_spacing is None else round(LENGTH / self.joint_spacing)

    def heights(self) -> FloatArray:
        """Heights that tires feel above the smooth road, shape (ROWS, COLUMNS), read-only [m].

        Row i is at station `i ALONG`, column j at the offset `j ACROSS` to the left of the
        reference line.
        """
        return _heights(self)

    def height(self, station: float, offset: float) -> float:
        """Height at one place above the smooth road [m], linear between the rows and columns."""
        row, column = station / ALONG, offset / ACROSS
        i, j = math.floor(row), math.floor(column)
        cell = self.heights()[np.ix_([i % ROWS, (i + 1) % ROWS], [j % COLUMNS, (j + 1) % COLUMNS])]
        u, v = row - i, column - j
        return float(np.array([1.0 - u, u]) @ cell @ np.array([1.0 - v, v]))

    def pothole_places(self) -> FloatArray:
        """Station, offset, diameter and depth of each pothole [m], shape (n, 4)."""
        random = np.random.default_rng([self.seed, 1])
        count = round(self.potholes * LENGTH / 1000.0 * WIDTH / _LANE)
        bounds = ((0.0, LENGTH), (0.0, WIDTH), POTHOLE_DIAMETER, POTHOLE_DEPTH)
        return np.column_stack([random.uniform(*bound, count) for bound in bounds])


SMOOTH = Unevenness()


@lru_cache(maxsize=4)
def _heights(uneven: Unevenness) -> FloatArray:
    heights = np.zeros((ROWS, COLUMNS))
    if CLASSES[uneven.roughness]:
        random = np.random.default_rng([uneven.seed, 0])
        heights = random_surface(CLASSES[uneven.roughness], random)
    for station, offset, diameter, depth in uneven.pothole_places():
        i = np.arange(int((station - diameter) / ALONG), int((station + diameter) / ALONG) + 1)
        j = np.arange(int((offset - diameter) / ACROSS), int((offset + diameter) / ACROSS) + 1)
        distance = np.hypot.outer(i * ALONG - station, j * ACROSS - offset)
        hole = depth * np.clip((0.5 * diameter - distance) / _FLANK, 0.0, 1.0)
        heights[np.ix_(i % ROWS, j % COLUMNS)] -= hole
    for k in range(uneven._joints):
        # A gap is shorter than two rows: its area goes to the rows about its middle.
        place = k * ROWS / uneven._joints
        row, share = int(place), place % 1.0
        area = JOINT_DEPTH * JOINT_GAP / ALONG
        heights[row] -= (1.0 - share) * area
        heights[(row + 1) % ROWS] -= share * area
    found = through_tire(heights)
    found.flags.writeable = False
    return found
