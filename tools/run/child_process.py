"""A process beside the daemon that says when it is ready, and ends with it."""

from __future__ import annotations

import os
import selectors
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from tonus.runtime.timing import clock
from tonus.tools.errors import ToolError

READY = b"ready"
_PIECE = 4096


@dataclass
class ChildProcess:
    """A child at work; its standard input closes with this process, and ends it."""

    process: subprocess.Popen[bytes]

    def ask(self, what: bytes) -> None:
        """Put it on the child's standard input; without effect where the child is gone. For a few
        bytes: it does not wait, because the pipe has room for them."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            os.write(self.process.stdin.fileno(), what)

    def stop(self, timeout_s: float = 10.0) -> None:
        """One that does not end in that time, because it hangs, is killed."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def start_child(
    command: Sequence[str], what: str, timeout_s: float, remedy: str, inherits: Sequence[int] = ()
) -> ChildProcess:
    """Start one, which ``inherits`` these descriptors, and wait until it says that it is ready.
    Raises `ToolError` with its own words when it cannot start, or when it does not answer in time;
    then it has been killed."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,
        pass_fds=inherits,
    )
    answer = b""
    try:
        answer = _first_line(process, what, timeout_s, remedy)
    finally:
        if answer != READY:
            process.kill()
            process.wait()
    if answer != READY:
        words = answer.decode(errors="replace").strip() or "it ended without a word"
        raise ToolError(f"{what} did not start: {words}")
    return ChildProcess(process)


def say(text: bytes) -> None:
    """In the child: a line to whoever started it."""
    sys.stdout.buffer.write(text + b"\n")
    sys.stdout.buffer.flush()


def _first_line(
    process: subprocess.Popen[bytes], what: str, timeout_s: float, remedy: str
) -> bytes:
    """What a process says first, without the line's end; b"" if it ends before. Raises `ToolError`
    if it says no whole line in time."""
    assert process.stdout is not None
    said, end = b"", clock.wall_seconds() + timeout_s
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while b"\n" not in said:
            if not selector.select(max(end - clock.wall_seconds(), 0.0)):
                raise ToolError(f"{what} did not answer within {timeout_s:g} s; {remedy}")
            piece = os.read(process.stdout.fileno(), _PIECE)
            if not piece:
                break
            said += piece
    return said.partition(b"\n")[0]
