"""The options `truck` and `payload`, which every command that drives or measures shares."""

from __future__ import annotations

from typing import Any, Protocol

from iits_mj.core.options import option
from iits_mj.parameters.files import shipped_trucks, truck_file
from iits_mj.parameters.truck import AnyTruck, TruckParameters


def truck_option(help: str = "truck", default_is: str = "the first name") -> Any:
    """Returns a dataclass field for the truck, of type `AnyTruck | None`.

    Args:
      help: what the truck does, in words.
      default_is: what None means, in words.
    """
    return option(
        None,
        help=f"{help}: a name, a truck.toml or its folder; without it {default_is}",
        names=shipped_trucks,
        test=lambda truck: isinstance(truck, TruckParameters) or truck_file(truck),
        label=lambda truck: truck.name if isinstance(truck, TruckParameters) else str(truck),
        metavar="NAME|FILE",
        group="truck",
    )


def payload_option(
    default: float | None = None,
    help: str = "load of the truck; without it the greatest that it may carry",
) -> Any:
    """Returns a dataclass field for the payload [kg], which `check_truck` bounds."""
    return option(default, help=help, unit="kg", low=0.0, metavar="KG", group="truck")


class OfTruck(Protocol):
    """Settings that name a truck and its payload [kg], each None for the default."""

    @property
    def truck(self) -> AnyTruck | None:
        """Name or file of the truck, or its parameters."""

    @property
    def payload(self) -> float | None:
        """Load of all units together [kg]."""


def check_truck(settings: OfTruck) -> TruckParameters:
    """Returns the truck of some settings.

    Raises:
      InputError: there is no such truck, its file is wrong, or it may not carry the payload.
    """
    parameters = TruckParameters.load(settings.truck)
    parameters.check_payload(settings.payload)
    return parameters
