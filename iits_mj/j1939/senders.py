"""Who may command the truck: addresses of senders."""

from __future__ import annotations

import functools
from collections.abc import Iterable

from iits_mj.errors import InputError
from iits_mj.j1939.mapping import reports, sender

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
