"""Where a drive keeps its errors: 0x603F, the register 0x1001, and the history 0x1003."""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.cia402.errors import ErrorTable, Recovery
from tonus.sim.devices.objects import RANGE, AbortError, ObjectDictionary


class ErrorMemory:
    """Works on the entries of a dictionary. ``present``: codes whose fault is not reset yet;
    ``warning``: whether one of those that only warn is."""

    def __init__(
        self, objects: ObjectDictionary, errors: ErrorTable, cleared: Callable[[], None]
    ) -> None:
        """``cleared`` is called when somebody has cleared the history."""
        self.present: set[int] = set()
        self._errors = errors
        self._waiting: set[int] = set()  # for something to happen before they can be reset
        self._cleared = cleared
        self._code = objects.find(0x603F, 0)
        self._register = objects.find(0x1001, 0)
        self._count = objects.find(0x1003, 0)
        self._history = [
            objects.find(index, number)
            for index, number in sorted(objects.entries)
            if index == 0x1003 and number
        ]
        self._count.write = self._clear_history

    @property
    def code(self) -> int:
        """0x603F"""
        return int(self._code.value)

    @property
    def warning(self) -> bool:
        return any(self._errors[code].reaction == "W" for code in self.present)

    def push(self, code: int) -> int:
        """Remember an error, newest first; the error register as it is now."""
        error = self._errors[code]
        for place in range(len(self._history) - 1, 0, -1):
            self._history[place].value = self._history[place - 1].value
        if self._history:
            self._history[0].value = code | error.register << 16
        self._count.value = min(int(self._count.value) + 1, len(self._history))
        self.present.add(code)
        self._waiting.add(code)
        self._show()
        if error.reaction != "W":
            self._code.value = code
        return int(self._register.value)

    def _show(self) -> None:
        register = 0
        for code in self.present:
            register |= self._errors[code].register
        self._register.value = register

    def needs(self, recovery: Recovery) -> bool:
        """Whether an error waits for this before it can be reset."""
        return any(self._errors[code].recovery is recovery for code in self._waiting)

    def recovered(self, recovery: Recovery) -> None:
        """What these errors waited for has happened; a fault reset will do now."""
        self._waiting = {
            code for code in self._waiting if self._errors[code].recovery is not recovery
        }

    def clear(self) -> None:
        """No error remains but what needs the history cleared; the history stays."""
        self.present = {c for c in self.present if self._errors[c].recovery is Recovery.HISTORY}
        self._waiting = set()
        self._code.value = 0
        self._show()

    def restart(self) -> None:
        """As at switch-on: the history is not kept without power."""
        self.present = set()
        self._waiting = set()
        self._code.value = self._register.value = self._count.value = 0
        for entry in self._history:
            entry.value = 0

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise AbortError(RANGE)
        for entry in self._history:
            entry.value = 0
        self.present = {c for c in self.present if self._errors[c].recovery is not Recovery.HISTORY}
        self._show()
        self._cleared()
