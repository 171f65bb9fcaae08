"""Fits each driver of recorded leader-follower pairs and prints the table of parameters.

`python docs/estimates/traffic_calibrated_drivers.py FILE` prints the content of
docs/validation/traffic_calibrated_drivers.csv. FILE is the reconstructed NGSIM set of
docs/traffic_fidelity.md. The table has only parameters, from which no trajectory can be restored.
The fits take some minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from iits_mj.validation.traffic.fit import calibrated
from traffic_bridge.datasets import pairs, read_trajectories
from traffic_bridge.vehicles.calibration import calibrate_each, calibrate_headways, trimmed

COLUMNS = (
    "lane,desired_speed_mps,time_headway_s,minimum_gap_m,acceleration_mps2,deceleration_mps2,"
    "gap_error_percent,own_headway_s,own_headway_gap_error_percent"
)


def main(path: Path) -> None:
    """Prints the table of a recorded set."""
    found = trimmed(pairs(read_trajectories(path)))
    common = calibrated(found).common.parameters
    each = calibrate_each(found, begin=common)
    headways = calibrate_headways(found, common)
    v0, t, s0, a, b = common.as_array().tolist()
    print(
        "# IDM parameters fitted to each leader-follower pair of the reconstructed NGSIM I-80 set,"
    )
    print(
        "# 16:00 to 16:15, mixed gap error; lane from the right. own_headway: only T fitted, with"
    )
    print(
        f"# the common set v0 {v0:.2f} m/s, T {t:.3f} s, s0 {s0:.2f} m, a {a:.3f}, b {b:.3f} m/s2."
    )
    print(COLUMNS)
    for pair, own, headway in zip(found, each, headways, strict=True):
        v0, t, s0, a, b = own.parameters.as_array().tolist()
        print(
            f"{pair.lane},{v0:.3f},{t:.3f},{s0:.3f},{a:.3f},{b:.3f},{100.0 * own.error:.2f},"
            f"{headway.parameters.time_headway:.2f},{100.0 * headway.error:.2f}"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
