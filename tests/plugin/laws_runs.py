"""Runs of powertrain and air brake without MuJoCo, and the signals that they had.

python -m tests.plugin.laws_runs        # writes laws_runs.csv after a wanted change of a law
"""

import csv
import itertools
from pathlib import Path

import numpy as np

from tests.plugin.laws_direct import law

REFERENCE = Path(__file__).with_name("laws_runs.csv")

# Seconds; pedal, engine brake, retarder, mode, shaft torque demand, cut, mass, grade force.
LADEN = [
    (40, [1, 0, 0, 0, 0, 0, 40e3, 1e3]),
    (20, [1, 0, 0, 0, 0, 0, 40e3, 22e3]),
    (10, [0.5, 0, 0, 0, 0, 0, 40e3, 3e3]),
    (12, [0, 1, 0, 0, 0, 0, 40e3, -12e3]),
    (6, [0, 0.3, 0.7, 0, 0, 0, 40e3, -12e3]),
    (5, [0.4, 0, 0, 0, 6000, 1, 40e3, 0]),
    (12, [1, 0, 0, 0, 0, 0, 40e3, 4e3]),
    (3, [0.3, 0, 0, 1, 0, 0, 40e3, 4e3]),
    (4, [0.3, 0, 0, 0, 0, 0, 40e3, 4e3]),
    (12, [0, 0, 0, 0, 3000, 0, 40e3, 20e3]),
    (8, [0.5, 0, 0, 2, 0, 0, 40e3, 0]),
    (3, [0, 0, 0, 2, 0, 0, 40e3, 0]),
]
EMPTY = [
    (45, [1, 0, 0, 0, 0, 0, 15e3, 0]),
    (15, [0.5, 0, 0, 0, 0, 0, 15e3, 1e3]),
    (10, [0.25, 0, 0, 0, 0, 0, 15e3, 8e3]),
    (8, [1, 0, 0, 0, 0, 0, 15e3, 8e3]),
    (15, [0.97, 0, 0, 0, 0, 0, 15e3, 14e3]),
    (6, [0.02, 0, 0, 0, 0, 0, 15e3, 1e3]),
    (8, [0, 0.6, 0, 0, 0, 0, 15e3, -3e3]),
    (10, [0.7, 0, 0, 0, 0, 0, 15e3, 1e3]),
]
STEEP = [
    (10, [0.6, 0, 0, 0, 0, 0, 30e3, 0]),
    (30, [1, 0, 0, 0, 0, 0, 30e3, 30e3]),
    (10, [0.9, 0, 0, 0, 0, 0, 30e3, 10e3]),
    (10, [0, 0, 1, 0, 0, 0, 30e3, -15e3]),
]
# Demand as in brake_update; parking, friction left and right, grade force, seconds, speed, mass.
STOPS = {
    "dry": ([4, 0, 2, 0, 0, 0, 0, 0, 0, 2e3, 8e3], 0, 0.8, 0.8, 0, 6, 20, 20e3),
    "wet": ([8, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0], 0, 0.3, 0.3, 0, 6, 15, 20e3),
    "split": ([0, 0.9, 0, 0, 0, 0, 0, 0, 0, 0, 0], 0, 0.7, 0.2, 0, 6, 18, 12e3),
    "integrated": ([2, 0, 1, 2, 0, 0, 0, 0, 0, 9e3, 3e4], 0, 0.8, 0.8, -5e3, 8, 20, 20e3),
    "parked": ([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], 1, 0.8, 0.8, -8e3, 4, 3, 16e3),
}


def drive(adaptive, segments, speed=0.0, h=0.002):
    """Signals over time, a row per 0.1 s."""
    columns = law("drive_columns")
    state, rows = np.zeros(law("drive_state")), []
    for seconds, controls in segments:
        signals = np.zeros((round(10 * seconds), columns))
        speed = law("drive", adaptive, controls, float(seconds), speed, h, state, signals)
        rows.append(signals)
    return np.concatenate(rows)


def stop(demand, *numbers, prepared=None, repeat=1, h=0.002):
    """Signals over time, a row per 0.05 s."""
    signals = np.zeros((round(20 * numbers[4]), 30))
    law("stop", [*demand, 0, 0], *map(float, numbers), prepared or h, repeat, h, signals)
    return signals


def choices(adaptive):
    """Chosen gear, failure and call for a lower gear, a row per situation."""
    rows = []
    failed = np.zeros(1)
    for gear, engine, pedal, load, mass, slope, time in itertools.product(
        range(1, 6),
        (75, 95, 120, 150, 180, 205, 230),
        (0, 0.2, 0.5, 0.8, 1),
        (0, 400, 1200, 3000, 7000),
        (15e3, 40e3),
        (0, -1),
        (3.0005, 9.0005),
    ):
        ratio = (11.67, 6, 3.2, 1.8, 1)[gear - 1]
        brake = 1 if pedal == 0 and slope == 0 else 0
        inputs = [pedal, brake, engine / ratio, load, engine, mass, pedal, brake, 0]
        state = [gear, gear, 0, 0, time, 1, 0, slope, 0, load, 0.6, 2 * (mass > 2e4) - 1, 0, 0]
        chosen = law("shift_choice", adaptive, gear, inputs, state, 0.002, failed)
        calls = law("shift_low_time", adaptive, gear, inputs, state, 0.002) > 1
        rows.append([chosen, failed[0], calls])
    return np.array(rows)


def runs():
    """Signals of every run by its name."""
    found = {}
    for name, segments in (("laden", LADEN), ("empty", EMPTY), ("steep", STEEP)):
        for adaptive in (0, 1):
            found[f"{name} {('tables', 'adaptive')[adaptive]}"] = drive(adaptive, segments)
    found["rolling"] = drive(0, LADEN[6:7], speed=60.0)
    for adaptive in (0, 1):
        found[f"choices {('tables', 'adaptive')[adaptive]}"] = choices(adaptive)
    return found | {name: stop(*arguments) for name, arguments in STOPS.items()}


def summary():
    """Rows of run, signal, mean, standard deviation, and last value."""
    for name, signals in runs().items():
        for i, signal in enumerate(signals.T):
            yield name, i, signal.mean(), signal.std(), signal[-1]


if __name__ == "__main__":
    with REFERENCE.open("w", newline="") as lines:
        writer = csv.writer(lines, lineterminator="\n")
        writer.writerow(["run", "signal", "mean", "deviation", "end"])
        for name, signal, *numbers in summary():
            writer.writerow([name, signal, *(f"{number:.9g}" for number in numbers)])
