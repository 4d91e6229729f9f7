"""python-canopen's waits in a lab's time: its modules get another `time`, `queue` and `threading`.

Only names inside python-canopen are replaced, and only while a lab has a network. Its own threads
and those of others are not meant to use it then.
"""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Protocol, Self

from tonus.tools.errors import ToolError

_LOOK_S = 1e-5
"""that pass with each look at the clock: a loop that only looks at it comes to an end. Less than a
frame takes, or an answer could arrive between two looks"""
_LONGEST_S = 60.0
"""of the lab's time; who waits longer waits for ever"""
_in_use = False


class Waiting(Protocol):
    """The part of a lab that passes time."""

    @property
    def now(self) -> float: ...
    def wait(self, holds: Callable[[], bool], seconds: float) -> bool: ...


@contextmanager
def virtual_waits(lab: Waiting) -> Iterator[None]:
    """Let python-canopen wait in the time of ``lab``. Raises `ToolError` if it does so in that of
    another one."""
    global _in_use  # noqa: PLW0603  # python-canopen's modules are one for the whole process
    if _in_use:
        raise ToolError("another open lab has a CANopen network; close that lab first")
    replaced = _replaced(lab)
    _in_use = True
    for module, name, instead in replaced:
        setattr(module, name, instead)
    try:
        yield
    finally:
        _in_use = False
        for module, name, instead in replaced:
            setattr(module, name, instead.original)


class _Instead:
    """A module with some names of its own."""

    def __init__(self, original: ModuleType, **names: Any) -> None:
        self.original = original
        self.__dict__.update(names)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.original, name)


def _replaced(lab: Waiting) -> list[tuple[ModuleType, str, _Instead]]:
    """Module, name, replacement."""
    instead: dict[str, Callable[[ModuleType], _Instead]] = {
        "time": lambda original: _clock(lab, original),
        "queue": lambda original: _Instead(original, Queue=lambda: _Queue(lab)),
        "threading": lambda original: _Instead(original, Condition=lambda: _Condition(lab)),
    }
    return [
        (module, name, make(getattr(module, name)))
        for key, module in sorted(sys.modules.items())
        if key == "canopen" or key.startswith("canopen.")
        for name, make in instead.items()
        if isinstance(getattr(module, name, None), ModuleType)
        and getattr(module, name).__name__ == name
    ]


def _clock(lab: Waiting, original: ModuleType) -> _Instead:
    def sleep(seconds: float) -> None:
        lab.wait(lambda: False, seconds)

    def now() -> float:
        sleep(_LOOK_S)
        return lab.now

    return _Instead(original, sleep=sleep, time=now, monotonic=now)


class _Queue(queue.Queue[Any]):
    def __init__(self, lab: Waiting) -> None:
        super().__init__()
        self._lab = lab

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if block:
            self._lab.wait(lambda: not self.empty(), _LONGEST_S if timeout is None else timeout)
        return super().get(block=False)


class _Condition:
    """Of one thread: whoever notifies does so while this one waits."""

    def __init__(self, lab: Waiting) -> None:
        self._lab, self._count = lab, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def wait(self, timeout: float | None = None) -> bool:
        before = self._count
        seconds = _LONGEST_S if timeout is None else timeout
        return self._lab.wait(lambda: self._count != before, seconds)

    def notify(self, n: int = 1) -> None:
        del n
        self._count += 1

    def notify_all(self) -> None:
        self._count += 1
