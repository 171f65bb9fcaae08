"""Factors from the units of the field to SI, and gravity."""

import math

GRAVITY = 9.81  # [m/s2]
RPM = 2.0 * math.pi / 60.0  # [rad/s]
KMH = 1.0 / 3.6  # [m/s]
