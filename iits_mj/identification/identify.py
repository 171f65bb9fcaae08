"""`identify`: a recorded drive in, identified parameters with their confidence out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from iits_mj.core.errors import InputError
from iits_mj.identification.brakes import identify_brake_response
from iits_mj.identification.engine import identify_engine
from iits_mj.identification.estimate import Estimate
from iits_mj.identification.lateral import identify_cornering, identify_ratio
from iits_mj.identification.log import Log
from iits_mj.identification.motion import Motion, identify_motion
from iits_mj.identification.shifts import identify_shifts
from iits_mj.parameters import TruckParameters

# Groups of parameters, each with its own fit; the mass that motion shows serves all others.
GROUPS = ("motion", "engine", "shifts", "brakes", "steering")


@dataclass(frozen=True)
class Identification:
    """What a log showed.

    Attributes:
      estimates: one for each parameter of the groups asked for.
      motion: speeds of the point mass before and after.
      mass: gross mass, identified or given [kg]; None when it is not known.
      parameters: the truck's parameters before the fit.
    """

    estimates: tuple[Estimate, ...]
    motion: Motion
    mass: float | None
    parameters: TruckParameters

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise InputError(f"no estimate {name!r}; there are {[e.name for e in self.estimates]}")

    def found(self) -> dict[str, float]:
        """Value of each identified parameter by its name."""
        return {e.name: e.value for e in self.estimates if e.identifiable}


def identify(
    log: Log,
    parameters: TruckParameters | None = None,
    *,
    mass: float | None = None,
    groups: Sequence[str] = GROUPS,
) -> Identification:
    """Fits the truck's parameters to a recorded drive.

    Args:
      log: the drive; what a group needs and the log lacks is said in the estimates' reasons.
      parameters: prior values, and all that is not fitted; default the shipped truck.
      mass: gross mass when it is known [kg]; the engine torque's scale can be fitted only then.
      groups: of `GROUPS`, what to fit.

    Raises:
      InputError: unknown group.
    """
    parameters = parameters or TruckParameters.load()
    unknown = [name for name in groups if name not in GROUPS]
    if unknown:
        raise InputError(f"cannot identify {unknown[0]!r}; there are {list(GROUPS)}")
    motion = identify_motion(log, parameters, mass)
    shown = any(e.name == "mass" and e.identifiable for e in motion.estimates)
    known = motion.mass if shown or mass is not None else None
    fits: dict[str, Callable[[], Sequence[Estimate]]] = {
        "motion": lambda: motion.estimates,
        "engine": lambda: identify_engine(log, parameters),
        "shifts": lambda: identify_shifts(log, parameters),
        "brakes": lambda: identify_brake_response(log, parameters),
        "steering": lambda: _steering(log, parameters, known),
    }
    estimates = [estimate for name in GROUPS if name in groups for estimate in fits[name]()]
    return Identification(tuple(estimates), motion, known, parameters)


def _steering(log: Log, parameters: TruckParameters, mass: float | None) -> list[Estimate]:
    """Ratio, by the two angles where the log has both, and cornering coefficients."""
    ratio = identify_ratio(log, parameters)
    value = ratio.value if ratio is not None and ratio.identifiable else None
    cornering = identify_cornering(log, parameters, mass, value)
    return cornering if ratio is None else [ratio, *cornering]
