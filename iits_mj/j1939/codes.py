"""Codes by which control units say who decides, in which range, and for whom the brakes work."""

from __future__ import annotations

from iits_mj.j1939 import addresses
from iits_mj.messages import TransmissionMode, TruckReport, XbrMode

# Travel above which a pedal counts as pressed.
PRESSED = 1e-3
# SPN 2918: 1 the driver's demand, 2 XBR in addition mode, 3 XBR in maximum mode.
_DRIVER = 1.0
_EXECUTION: dict[int, float] = {XbrMode.ADDITION: 2.0, XbrMode.MAXIMUM: 3.0}
# SPN 899 and 900: who decides on the torque of an engine or a retarder.
_NO_REQUEST, _OPERATOR, _TRANSMISSION, _BRAKES = 0.0, 1.0, 6.0, 10.0
_CONTROLLERS = {_TRANSMISSION: addresses.TRANSMISSION, _BRAKES: addresses.BRAKES}
# SPN 162 and 163: two letters, of which a single one is the second, after a blank.
RANGES: dict[int, float] = {
    mode: float(int.from_bytes(f" {letter}".encode(), "little"))
    for mode, letter in (
        (TransmissionMode.DRIVE, "D"),
        (TransmissionMode.NEUTRAL, "N"),
        (TransmissionMode.REVERSE, "R"),
    )
}


def driver_percent(lever: float | None, available: float | None) -> float | None:
    """What the driver's lever asks of a retarder, as a (negative) percentage like `available`."""
    return None if lever is None or available is None else lever * available


def engine_brake_mode(report: TruckReport) -> float | None:
    """Who decides on the engine brake (SPN 900): nobody, the driver's lever, the brakes."""
    return _mode(
        report.engine_brake,
        report.engine_brake_torque_percent_available,
        report.engine_brake_torque_percent_intended,
    )


def retarder_mode(report: TruckReport) -> float | None:
    """The same of the driveline's retarder."""
    return _mode(
        report.retarder,
        report.retarder_torque_percent_available,
        report.retarder_torque_percent_intended,
    )


def controller(mode: float | None, own: int) -> float | None:
    """Address of the unit that controls another, which may be that itself."""
    return None if mode is None else float(_CONTROLLERS.get(mode, own))


def direction(gear: float | None) -> float | None:
    """The selector's place that a gear belongs to."""
    if gear is None:
        return None
    if gear == 0:
        return TransmissionMode.NEUTRAL
    return TransmissionMode.DRIVE if gear > 0 else TransmissionMode.REVERSE


def letters_of_range(mode: float | None) -> float | None:
    """A place of the selector as its two letters (SPN 162 and 163)."""
    return None if mode is None else RANGES.get(round(mode))


def execution(report: TruckReport) -> float | None:
    """Whose demand the brakes execute (SPN 2918)."""
    if report.xbr_active is None or report.xbr_mode is None:
        return None
    if report.xbr_active > 0.5:
        return _EXECUTION.get(round(report.xbr_mode), 0.0)
    return _DRIVER if (report.brake_pedal or 0.0) > PRESSED else 0.0


def _mode(lever: float | None, available: float | None, intended: float | None) -> float | None:
    driver = driver_percent(lever, available)
    if driver is None or intended is None:
        return None
    # Half a bit of the percentages.
    if intended > -0.5:
        return _NO_REQUEST
    return _BRAKES if intended < driver - 0.5 else _OPERATOR
