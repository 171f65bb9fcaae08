"""The truck's J1939 interface: messages to CAN frames and back, and the buses that carry them.

The layouts are in `iits_mj.dbc` (`database_path()`), written from public facts; `signals.csv` maps
signals to controls and sensors. Inside one process a `VehicleCommand` goes straight to the model's
controls. Over a bus, `command_to_frames` makes its frames, and `CommandReceiver` is the truck's
side with its fail-safe.
"""

from iits_mj.j1939.bus import Bus, Link, LinkState
from iits_mj.j1939.bus_summary import BusReader, BusSummary, summarize, write_table
from iits_mj.j1939.command import CommandSender, command_to_frames
from iits_mj.j1939.configuration import ConfigurationReceiver, ConfigurationSender
from iits_mj.j1939.database import (
    Decoded,
    cycle_time,
    decode,
    encode,
    group_type,
    make_group,
    message_names,
    pack,
    pgn_of,
    unpack,
)
from iits_mj.j1939.diagnostics import (
    ActiveFaults,
    ComponentIdentification,
    Fault,
    SoftwareIdentification,
    VehicleIdentification,
    read_group,
)
from iits_mj.j1939.frame import Frame, make_id
from iits_mj.j1939.groups import NOT_AVAILABLE, Group, Status, Value, database_path
from iits_mj.j1939.log_files import LogWriter, read_log
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.j1939.receiver import CommandReceiver, Heard, Loss, TimeOuts
from iits_mj.j1939.requests import Reason
from iits_mj.j1939.state import StateReceiver, StateSender, state_to_frames
from iits_mj.j1939.transport import BroadcastSender, Failure, LongMessage, Reassembler, broadcast

__all__ = [
    "NOT_AVAILABLE",
    "ActiveFaults",
    "BroadcastSender",
    "Bus",
    "BusReader",
    "BusSummary",
    "CommandReceiver",
    "CommandSender",
    "ComponentIdentification",
    "ConfigurationReceiver",
    "ConfigurationSender",
    "Decoded",
    "Failure",
    "Fault",
    "Frame",
    "Group",
    "Heard",
    "Link",
    "LinkState",
    "LogWriter",
    "LongMessage",
    "Loss",
    "Reason",
    "Reassembler",
    "ReferenceTorques",
    "SoftwareIdentification",
    "StateReceiver",
    "StateSender",
    "Status",
    "TimeOuts",
    "Value",
    "VehicleIdentification",
    "broadcast",
    "command_to_frames",
    "cycle_time",
    "database_path",
    "decode",
    "encode",
    "group_type",
    "make_group",
    "make_id",
    "message_names",
    "pack",
    "pgn_of",
    "read_group",
    "read_log",
    "state_to_frames",
    "summarize",
    "unpack",
    "write_table",
]
