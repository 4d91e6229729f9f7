"""Standard output and standard error of a process, which no reader and no full disk can disturb.

What cannot be printed is dropped, and the process goes on: a run must not depend on who watches it.
`lost` tells a command that its answer did not arrive.
"""

from __future__ import annotations

import errno
import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

_NAMES = {1: "standard output", 2: "standard error"}


class _Descriptor(io.FileIO):
    """Takes everything, and writes what can be written."""

    def __init__(self, number: int) -> None:
        super().__init__(number, "w", closefd=False)
        self.failure: OSError | None = None
        self.hurried = False

    def write(self, data: bytes) -> int:  # type: ignore[override]  # any buffer, as FileIO takes it
        if self.failure is None and not (self.hurried and self._would_wait()):
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return len(data)

    def _would_wait(self) -> bool:
        """A pipe nobody reads and a terminal that is held (Ctrl-S) have no room."""
        try:
            return not select.select([], [self.fileno()], [], 0.0)[1]
        except (OSError, ValueError):
            return False


_installed: dict[int, _Descriptor] = {}
_optional = False


def install() -> None:
    """Take over standard output and error of this process. One that is closed is given the null
    device, since the next file to be opened would have its number otherwise."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gives the lowest free number, which is this one
    sys.stdout = _taken_over(1, sys.stdout)
    sys.stderr = _taken_over(2, sys.stderr)


def _taken_over(number: int, stream: TextIO | None) -> TextIO:
    if stream is not None:
        try:
            if stream.fileno() != number:
                return stream  # somebody else's, as under a test
        except OSError:
            return stream
        with suppress(OSError):
            stream.flush()
    descriptor = _installed[number] = _Descriptor(number)
    return io.TextIOWrapper(
        io.BufferedWriter(descriptor),  # type: ignore[type-var]  # its write takes any buffer
        encoding=getattr(stream, "encoding", None) or "utf-8",
        errors="replace",
        line_buffering=number == 2 or os.isatty(number),
    )


@contextmanager
def hurried() -> Iterator[None]:
    """Within it nothing waits for a reader: what it does not take at once is dropped."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    for each in _installed.values():
        each.hurried = True
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for each in _installed.values():
            each.hurried = False


def make_optional() -> None:
    """What this command prints is for whoever looks on; its result lies elsewhere."""
    global _optional  # noqa: PLW0603  # one process has one standard output
    _optional = True


def is_optional() -> bool:
    """Whether `make_optional` was called."""
    return _optional


def reader_left() -> bool:
    """Whether nobody will ever read what is printed."""
    return 1 in _installed and _installed[1].failure is not None


def lost() -> str | None:
    """What kept standard output from being written, in words; None where all of it arrived, and
    where its reader left on purpose (``| head``)."""
    with suppress(ValueError):
        sys.stdout.flush()
    failure = _installed[1].failure if 1 in _installed else None
    if failure is None or failure.errno == errno.EPIPE:
        return None
    return f"{_NAMES[1]}: {(failure.strerror or 'cannot be written').lower()}"
