"""The truck's J1939 interface: messages to CAN frames and back, and the buses that carry them.

The layouts are in `iits_mj.dbc` (`database_path()`), written from public facts. In process the
`VehicleCommand` goes straight to the model's controls; over a bus the same command is the frames of
`command_to_frames`, and `CommandReceiver` is the truck's side with its fail-safe. Which signal is
which control or sensor stands in `signals.csv`.
"""

from iits_mj.j1939.bus import Bus, LogWriter, read_log
from iits_mj.j1939.command import command_to_frames
from iits_mj.j1939.database import (
    Decoded,
    Status,
    cycle_time,
    database_path,
    decode,
    encode,
    message_names,
    pgn_of,
)
from iits_mj.j1939.frame import Frame, make_id
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.j1939.receiver import CommandReceiver, TimeOuts
from iits_mj.j1939.state import StateReceiver, state_to_frames

__all__ = [
    "Bus",
    "CommandReceiver",
    "Decoded",
    "Frame",
    "LogWriter",
    "ReferenceTorques",
    "StateReceiver",
    "Status",
    "TimeOuts",
    "command_to_frames",
    "cycle_time",
    "database_path",
    "decode",
    "encode",
    "make_id",
    "message_names",
    "pgn_of",
    "read_log",
    "state_to_frames",
]
