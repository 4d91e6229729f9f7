"""Jobs in processes of their own, so many at a time: what one does cannot harm another."""

from __future__ import annotations

import gc
import os
import selectors
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from tonus.tools.forking import die_with_parent

Job = TypeVar("Job")
Tell = Callable[[bytes], None]
"""Takes a line, without its end."""
_CHUNK = 1 << 16
_CRASHED = 70
"""exit code of a process that an exception ended"""


class Said(NamedTuple, Generic[Job]):
    """A line that a job's process has said; after the last one, None and its exit code."""

    job: Job
    line: bytes | None
    exit_code: int = 0


@dataclass
class _Process(Generic[Job]):
    number: int
    pipe: int
    job: Job
    text: bytearray = field(default_factory=bytearray)


def forked(
    jobs: Iterable[Job], workers: int, work: Callable[[Job, Tell], None]
) -> Iterator[Said[Job]]:
    """Do ``work`` on each job in a fork of this process, which must have no thread and no running
    loop; what it has imported and compiled they need not. Lines come as they are said. Whoever
    stops listening ends the processes."""
    left = deque(jobs)
    running: list[_Process[Job]] = []
    try:
        with selectors.DefaultSelector() as selector:
            while left or running:
                while left and len(running) < workers:
                    process = _start(left.popleft(), work)
                    running.append(process)
                    selector.register(process.pipe, selectors.EVENT_READ, process)
                for key, _ in selector.select():
                    process = key.data
                    data = os.read(process.pipe, _CHUNK)
                    process.text += data
                    *lines, rest = bytes(process.text).split(b"\n")
                    process.text = bytearray(rest)
                    for line in lines:
                        yield Said(process.job, line)
                    if not data:
                        selector.unregister(process.pipe)
                        os.close(process.pipe)
                        _, status = os.waitpid(process.number, 0)
                        running.remove(process)
                        yield Said(process.job, None, os.waitstatus_to_exitcode(status))
    finally:
        for process in running:
            os.kill(process.number, signal.SIGKILL)
            os.waitpid(process.number, 0)
            os.close(process.pipe)


def crashed(exit_code: int) -> str:
    """Why a process ended without a word."""
    if exit_code < 0:
        return f"crashed: {signal.Signals(-exit_code).name}"
    return f"crashed: exit code {exit_code}"


def _start(job: Job, work: Callable[[Job, Tell], None]) -> _Process[Job]:
    ours, theirs = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    number = os.fork()
    if number == 0:
        code = _CRASHED
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            die_with_parent()
            os.close(ours)
            # A job is over before what it leaves behind is worth looking for.
            gc.disable()
            work(job, lambda line: _write(theirs, line))
            code = 0
        finally:
            os._exit(code)
    os.close(theirs)
    return _Process(number, ours, job)


def _write(pipe: int, line: bytes) -> None:
    data = line + b"\n"
    while data:
        data = data[os.write(pipe, data) :]
