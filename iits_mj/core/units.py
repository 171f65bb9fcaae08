"""Factors from the units of the field to SI, and gravity."""

import math

GRAVITY = 9.81  # [m/s2]
RPM = 2.0 * math.pi / 60.0  # [rad/s]
KMH = 1.0 / 3.6  # [m/s]
# Diesel at 15 degrees C, middle of EN 590's 820 to 845 kg/m3.
DIESEL_DENSITY = 0.832  # [kg/l]
