"""The truck: `Truck` loads, places, commands and observes it; fleets and threaded roll-outs."""

from iits_mj.truck.truck import COMMAND_FIELDS, Truck

__all__ = ["COMMAND_FIELDS", "Truck"]
