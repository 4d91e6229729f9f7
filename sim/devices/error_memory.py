"""Where a drive keeps its errors: 0x603F, the register 0x1001, and the history 0x1003."""

from __future__ import annotations

from sim.devices.epos4_objects import HISTORY
from sim.devices.objects import RANGE, AbortError, ObjectDictionary


class ErrorMemory:
    """Works on the entries of a dictionary."""

    def __init__(self, objects: ObjectDictionary) -> None:
        self._code = objects.find(0x603F, 0)
        self._register = objects.find(0x1001, 0)
        self._count = objects.find(0x1003, 0)
        self._history = [objects.find(0x1003, number) for number in range(1, HISTORY + 1)]
        self._count.write = self._clear_history

    def push(self, code: int, register: int, *, warning: bool) -> int:
        """Remember an error, newest first; the error register as it is now."""
        for place in range(HISTORY - 1, 0, -1):
            self._history[place].value = self._history[place - 1].value
        self._history[0].value = code | register << 16
        self._count.value = min(int(self._count.value) + 1, HISTORY)
        now = int(self._register.value) | register
        self._register.value = now
        if not warning:
            self._code.value = code
        return now

    def clear(self) -> None:
        """No error remains; the history stays."""
        self._code.value = self._register.value = 0

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise AbortError(RANGE)
        for entry in self._history:
            entry.value = 0
