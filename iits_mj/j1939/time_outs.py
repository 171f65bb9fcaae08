"""How long a command may stay away, and what the receiver tells of those that do."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, fields

from iits_mj.errors import InputError


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before a message's command falls back to its safe value.

    The defaults are five periods of the message: four frames may be lost in a row.

    Attributes:
      pedal: EEC2; xbr: XBR; body: IITS_COMMAND.
      engine_retarder, driveline_retarder: TSC1 to the one and to the other.
    """

    pedal: float = 0.25
    xbr: float = 0.1
    engine_retarder: float = 0.25
    driveline_retarder: float = 0.25
    body: float = 0.1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(
                    f"time-out {field.name} = {value!r} s: must be finite and positive"
                )


class Heard(enum.Enum):
    """What was heard of a command message at an instant.

    RELEASED: silent, after its last word was that it demands nothing, as J1939 lets XBR and TSC1.
    """

    NEVER = "never heard"
    ALIVE = "alive"
    RELEASED = "released"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Loss:
    """Which commands are missing at an instant, for who decides what to do about it."""

    pedal: Heard
    xbr: Heard
    engine_retarder: Heard
    driveline_retarder: Heard
    body: Heard

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the commands that were there and are gone."""
        names = (field.name for field in fields(self))
        return tuple(name for name in names if getattr(self, name) is Heard.SILENT)

    @property
    def driver(self) -> bool:
        """Whether nobody drives: no steering, or an accelerator or brake demand that is gone."""
        return self.body is not Heard.ALIVE or Heard.SILENT in (self.pedal, self.xbr)
