"""The content of messages of any length: those of the DBC and those of varying length."""

from __future__ import annotations

from iits_mj.errors import BusError
from iits_mj.j1939.database import pgn_of, unpack
from iits_mj.j1939.diagnostics import ActiveFaults
from iits_mj.j1939.group import Group
from iits_mj.j1939.identities import (
    ComponentIdentification,
    SoftwareIdentification,
    VehicleIdentification,
)
from iits_mj.j1939.layouts import layouts
from iits_mj.j1939.long_group import LongGroup

_VARYING: dict[int, type[LongGroup]] = {
    kind.PGN: kind
    for kind in (
        ActiveFaults,
        ComponentIdentification,
        SoftwareIdentification,
        VehicleIdentification,
    )
}
# Configurations have grown over the years; the first so many bytes were always there.
_GROWN = {"EC1": 28, "RC": 19}


def read_group(pgn: int, data: bytes) -> Group | LongGroup | None:
    """The group in the bytes of a message of any length; None for a PGN that is not known.

    EC1 and RC of older and newer control units are shorter or longer: what is missing is not
    available, what is beyond is left out.

    Raises:
      BusError: the bytes have not the length of the group.
    """
    varying = _VARYING.get(pgn)
    if varying is not None:
        return varying.from_bytes(data)
    for name, least in _GROWN.items():
        if pgn == pgn_of(name):
            length = layouts().get_message_by_name(name).length
            if len(data) < least:
                raise BusError(f"{name} has {len(data)} bytes: at least {least} are wanted")
            data = data[:length].ljust(length, b"\xff")
    return unpack(pgn, data)
