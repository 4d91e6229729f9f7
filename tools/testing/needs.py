"""What a test may need of the host, and why it is not there."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from importlib.util import find_spec


def _ethercat() -> str:
    return "" if find_spec("pysoem") else "pysoem is not installed (pip install tonus[ethercat])"


def _realtime() -> str:
    policy, given = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return "this user gets no real-time priority (tonus doctor)"
    os.sched_setscheduler(0, policy, given)
    return ""


def _root() -> str:
    return "" if os.geteuid() == 0 else "pytest does not run as root"


def _kernel_can() -> str:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return "this kernel has no SocketCAN (modprobe can_raw)"
    return ""


NEEDS: dict[str, Callable[[], str]] = {
    "ethercat": _ethercat,
    "realtime": _realtime,
    "root": _root,
    "kernel-can": _kernel_can,
}


def missing(what: str) -> str:
    """Why one of `NEEDS` is not met; empty: it is."""
    return NEEDS[what]()
