"""Preferred source addresses of the control units on the truck (SAE J1939, table B2)."""

from __future__ import annotations

import functools
from collections.abc import Iterable

from iits_mj.core.errors import InputError
from iits_mj.j1939.mapping import reports, sender

ENGINE = 0x00
TRANSMISSION = 0x03
BRAKES = 0x0B
ENGINE_RETARDER = 0x0F
DRIVELINE_RETARDER = 0x10
SUSPENSION = 0x2F
STABILITY = 0x3E
# Headway controller: who commands the truck, unless it says otherwise.
CONTROLLER = 0x2A


# --- Who may command the truck: addresses of senders ---

# 254 is "no address", 255 everybody: neither can send a command.
LAST_ADDRESS = 253


@functools.cache
def truck_addresses() -> frozenset[int]:
    """Addresses from which this truck reports."""
    return frozenset(sender(row) for row in reports())


@functools.cache
def everybody_else() -> frozenset[int]:
    """All addresses but the truck's own: who may command it by default."""
    return frozenset(range(LAST_ADDRESS + 1)) - truck_addresses()


def checked_sources(sources: Iterable[int]) -> frozenset[int]:
    """The addresses as a set.

    Raises:
      InputError: one of them is no address.
    """
    chosen = tuple(sources)
    for address in chosen:
        if type(address) is not int or not 0 <= address <= LAST_ADDRESS:
            raise InputError(f"source {address!r}: a J1939 address is 0 to {LAST_ADDRESS}")
    return frozenset(chosen)
