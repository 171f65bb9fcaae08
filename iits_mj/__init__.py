"""iits_mj: a self-driving articulated truck in MuJoCo.

Importing the package registers the engine plugin, so that `mujoco.MjModel.from_xml_path` reads the
truck's MJCF, and the Gymnasium environments (`iits_mj.envs`). SUMO, CasADi, SciPy and torch are
loaded only by the modules that need them.
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

import iits_mj.envs  # noqa: F401 (registers the environments)
from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import Error, PluginError
from iits_mj.plugin import register as _register_plugin

if TYPE_CHECKING:
    from iits_mj.core.messages import VehicleCommand
    from iits_mj.parameters import TruckParameters
    from iits_mj.truck import Truck

__all__ = ["Error", "Truck", "TruckParameters", "VehicleCommand", "__version__", "mjcf_path"]
__version__ = "0.1.0"

# Public names and the modules that define them, which are loaded on first use.
_MODULES = {
    "Truck": "iits_mj.truck",
    "TruckParameters": "iits_mj.parameters",
    "VehicleCommand": "iits_mj.core.messages",
}

try:
    _register_plugin()
except PluginError as error:
    # A warning only, so that `iits-mj doctor` runs; `Truck.load` raises the same error.
    warnings.warn(str(error), RuntimeWarning, stacklevel=2)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
