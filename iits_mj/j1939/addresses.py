"""Preferred source addresses of the control units on the truck (SAE J1939, table B2)."""

ENGINE = 0x00
TRANSMISSION = 0x03
BRAKES = 0x0B
ENGINE_RETARDER = 0x0F
DRIVELINE_RETARDER = 0x10
SUSPENSION = 0x2F
STABILITY = 0x3E
# Headway controller: who commands the truck, unless it says otherwise.
CONTROLLER = 0x2A
