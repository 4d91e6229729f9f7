"""The tracker's address on the host of a run, before anything of the run is started."""

from __future__ import annotations

import errno
import socket

from tonus.config.schema.root import Config
from tonus.tools.errors import ToolError

_REMEDY = "correct it in the configuration's tracker section, or give --set tracker.address=ADDRESS"


def need_known(config: Config) -> str:
    """The IPv4 address that stands for ``tracker.address``. Raises `ToolError` for a host name that
    this host does not know."""
    address = config.tracker.address
    try:
        found = socket.getaddrinfo(address, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        problem = f"this host knows no IPv4 address of {address!r} ({error.strerror or error})"
        raise ToolError(f"tracker.address: {problem}; {_REMEDY}") from error
    return str(found[0][4][0])


def need_own(config: Config) -> None:
    """Poses are received there. Raises `ToolError` for an address that is not of this host."""
    address = need_known(config)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind((address, 0))
        except OSError as error:
            if error.errno != errno.EADDRNOTAVAIL:
                return  # reported with the port, which is what is wrong then
            problem = f"{config.tracker.address} is not an address of this host"
            raise ToolError(
                f"tracker.address: {problem}; give one of its own, or 0.0.0.0 for all of them, "
                "in the configuration's tracker section or with --set tracker.address=ADDRESS"
            ) from error
