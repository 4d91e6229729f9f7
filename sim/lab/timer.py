"""A wake-up at an absolute time, to the microsecond, through the event loop.

asyncio's own timers are rounded up to a millisecond by epoll.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
from collections.abc import Callable

from tonus.sim.errors import LabError

_MONOTONIC = 1
_ABSOLUTE = 1
_SECOND_NS = 1_000_000_000
_SETTING = struct.Struct("@qqqq")
_libc = ctypes.CDLL(None, use_errno=True)


class WakeUp:
    """Calls ``callback`` at the time last given to `at` (ns on CLOCK_MONOTONIC)."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._file = _libc.timerfd_create(_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._file < 0:
            raise LabError(f"the host gives no timer: {os.strerror(ctypes.get_errno())}")
        self.due_ns = 0
        """when it will call, 0: not at all"""
        loop.add_reader(self._file, self._ring)

    def at(self, due_ns: int) -> None:
        """Replaces an earlier request; a time that has passed rings at once."""
        due_ns = max(due_ns, 1)
        if due_ns == self.due_ns:
            return
        self.due_ns = due_ns
        setting = _SETTING.pack(0, 0, due_ns // _SECOND_NS, due_ns % _SECOND_NS)
        if _libc.timerfd_settime(self._file, _ABSOLUTE, setting, None) < 0:
            raise LabError(f"the host's timer fails: {os.strerror(ctypes.get_errno())}")

    def _ring(self) -> None:
        try:
            os.read(self._file, 8)
        except BlockingIOError:
            return
        self.due_ns = 0
        self._callback()

    def close(self) -> None:
        self._loop.remove_reader(self._file)
        os.close(self._file)
