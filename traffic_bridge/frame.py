"""The vehicles of one instant, see `iits_mj.core.vehicles`."""

from iits_mj.core.vehicles import COLUMNS as COLUMNS
from iits_mj.core.vehicles import VehicleFrame as VehicleFrame
