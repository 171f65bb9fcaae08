"""The DBC file as cantools reads it."""

from __future__ import annotations

import functools
from pathlib import Path

import cantools.database.can


def database_path() -> Path:
    """Our DBC file, for other CAN tools."""
    return Path(__file__).with_name("iits_mj.dbc")


@functools.cache
def layouts() -> cantools.database.can.Database:
    """All messages of the DBC; read once."""
    database = cantools.database.can.Database()
    database.add_dbc_file(str(database_path()))
    return database


def class_name(message: str) -> str:
    """Name of the typed group: the message's own, or "IitsTrailer" of IITS_TRAILER."""
    return message.title().replace("_", "") if "_" in message else message
