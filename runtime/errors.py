"""What can go wrong in the daemon itself."""

from __future__ import annotations


class DaemonError(Exception):
    """The daemon cannot go on; the text is for a person."""


class RecordingError(DaemonError):
    """A ring or a log file cannot be written or read."""


class SchedulingError(DaemonError):
    """The host does not offer what a fixed period needs."""


class ControllerError(DaemonError):
    """A controller outside the package cannot be imported, made or used."""
