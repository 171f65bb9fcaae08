"""Exceptions of the project; all derive from `Error`."""


class Error(Exception):
    """Base class; the message names the quantity, its value and the allowed values."""


class InputError(Error, ValueError):
    """A value given by the user (argument, flag, file content) is not usable."""


class MapError(Error):
    """An OpenDRIVE map cannot be read, or needs something that is not supported."""


class PluginError(Error):
    """The MuJoCo engine plugin is missing, or built for another MuJoCo version."""


class TrafficError(Error):
    """SUMO refused a network, a route or a vehicle."""


class BusError(Error):
    """A CAN bus cannot be opened, or a frame is not valid."""


class PlanningError(Error):
    """An optimization or planning problem has no solution; the message gives the reason."""


class RenderError(Error):
    """Pictures cannot be rendered; the message names the packages that provide OpenGL."""
