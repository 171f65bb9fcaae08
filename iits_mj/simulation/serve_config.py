"""What a served truck is: one frozen dataclass, which is also the flags of `iits-mj serve`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj.j1939.senders import LAST_ADDRESS
from iits_mj.options import option
from iits_mj.simulation.config import TruckStart

BUSES = ("virtual", "socketcan", "udp_multicast")
SILENCE = ("release", "stop")


@dataclass(frozen=True, kw_only=True)
class ServeConfig(TruckStart):
    """A truck that is driven over a CAN bus.

    Raises:
      InputError: a value is out of its bounds, unknown, or not finite.
    """

    bus: str = option(
        "udp_multicast",
        help="virtual: within this process only; socketcan: a Linux CAN interface; udp_multicast: "
        "other processes and machines",
        choices=BUSES,
    )
    channel: str | None = option(
        None,
        help="CAN interface (can0), or multicast group with or without port (239.74.163.2:43113)",
        metavar="NAME",
    )
    start_speed: float = option(
        0.0,
        help="speed to start with; at 0 the parking brake holds until somebody commands",
        unit="m/s",
        low=0.0,
        high=30.0,
        metavar="MPS",
    )
    duration: float | None = option(
        None,
        help="time to serve; without it until Ctrl-C, SIGTERM, the end of the road or an accident",
        unit="s",
        low=0.1,
        high=1e7,
        metavar="S",
    )
    on_silence: str = option(
        "release",
        help="when commands stay away; release: let go of pedal and brakes, hold the steering; "
        "stop: brake smoothly to a stop in the lane and park",
        choices=SILENCE,
    )
    source: int | None = option(
        None,
        help="obey this sender only; without it every address but the truck's own",
        low=0,
        high=LAST_ADDRESS,
        metavar="ADDRESS",
    )
    can_log: Path | None = option(
        None, help="log of the bus, both ways; the suffix picks the format", metavar="FILE"
    )
