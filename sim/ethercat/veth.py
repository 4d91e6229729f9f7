"""The pair of network interfaces between a master and the lab, made and removed where it may be.

An interface that is there is used as it is: so may be real ones, joined by a cable.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from tonus.sim.errors import LabError

_INTERFACES = Path("/sys/class/net")
_PATIENCE_S = 10.0
_NOT_BROADCAST = "arp off"
"""Nothing but EtherCAT is to be on the cable."""


def commands(master: str, lab: str) -> list[str]:
    """What makes the pair, as one types it."""
    return [
        f"ip link add {master} type veth peer name {lab}",
        *(f"ip link set {name} {_NOT_BROADCAST} addrgenmode none up" for name in (master, lab)),
    ]


def exists(name: str) -> bool:
    """Whether the host has an interface of this name."""
    return (_INTERFACES / name).exists()


def open_pair(master: str, lab: str) -> bool:
    """Make the pair if the lab's end is not there; whether it was made. Raises `LabError`."""
    if exists(lab):
        return False
    if exists(master):
        raise LabError(
            f"{master} is there and {lab} is not, so they are no pair; name in "
            f"lab.ethercat.interface what {master} leads to"
        )
    remedy = "as root: " + " && ".join(commands(master, lab))
    if shutil.which("ip") is None:
        raise LabError(
            f"{lab} cannot be made: there is no ip command; install iproute2, then {remedy}"
        )
    for command in commands(master, lab):
        try:
            done = subprocess.run(
                command.split(), capture_output=True, text=True, check=False, timeout=_PATIENCE_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            close_pair(lab)
            raise LabError(f"{lab} cannot be made: {error}; {remedy}") from error
        if done.returncode:
            close_pair(lab)
            words = done.stderr.strip().splitlines()[-1:] or ["ip failed"]
            raise LabError(f"{lab} cannot be made: {words[0]}; {remedy}")
    return True


def close_pair(lab: str) -> None:
    """Remove a pair by one of its ends, if it is there."""
    if exists(lab):
        subprocess.run(
            [shutil.which("ip") or "ip", "link", "del", lab],
            capture_output=True,
            check=False,
            timeout=_PATIENCE_S,
        )
