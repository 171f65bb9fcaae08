"""iits_mj: a self-driving articulated truck in MuJoCo.

Importing the package registers the engine plugin, so that `mujoco.MjModel.from_xml_path` reads the
truck's MJCF. SUMO, CasADi and torch are loaded only by the modules that need them.
"""

import warnings

from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import Error, PluginError
from iits_mj.core.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.plugin import register as _register_plugin

__version__ = "0.1.0"

try:
    _register_plugin()
except PluginError as error:
    # `iits-mj doctor` must be able to say what helps; `Truck.load` raises the same error.
    warnings.warn(str(error), RuntimeWarning, stacklevel=2)

from iits_mj.truck import Truck

__all__ = ["Error", "Truck", "TruckParameters", "VehicleCommand", "__version__", "mjcf_path"]
