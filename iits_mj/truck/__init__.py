"""The truck in MuJoCo, fleets of trucks, and threaded rollouts."""

from iits_mj.truck.truck import COMMAND_FIELDS, Truck

__all__ = ["COMMAND_FIELDS", "Truck"]
