"""Processes that a process of ours forks."""

from __future__ import annotations

import ctypes
import signal

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG"""


def die_with_parent() -> None:
    """The calling process is killed when the one that started it ends, however that happens."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
