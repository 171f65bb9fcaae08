"""Exceptions of the project: every error a user can meet derives from `Error`."""


class Error(Exception):
    """Base class. The message names the thing, its value, and what is allowed."""


class InputError(Error, ValueError):
    """A value given by the user (argument, flag, file content) is not usable."""


class MapError(Error):
    """An OpenDRIVE map cannot be read, or asks for something that is not supported."""


class PluginError(Error):
    """The MuJoCo engine plugin is missing, or built for another MuJoCo version."""


class TrafficError(Error):
    """SUMO refused a network, a route or a vehicle."""


class BusError(Error):
    """A CAN bus cannot be opened, or a frame is not valid."""


class PlanningError(Error):
    """An optimisation or planning problem has no solution; the message gives the reason."""


class RenderError(Error):
    """Pictures cannot be made here; the message names the packages that bring OpenGL."""
