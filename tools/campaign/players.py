"""Groups of episodes on several processors, each group in a process of its own."""

from __future__ import annotations

import gc
import json
import os
import selectors
import signal
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from tonus.config.schema.campaign import Study
from tonus.tools.campaign.allowance import Allowance, for_torn_cables
from tonus.tools.campaign.episode import Episode, Group
from tonus.tools.campaign.judge import Row, failed
from tonus.tools.campaign.station import cause, play_group
from tonus.tools.forking import die_with_parent

_CHUNK = 1 << 16
_CRASHED = 70
"""exit code of a station that an exception ended"""


@dataclass
class _Process:
    number: int
    pipe: int
    waiting: dict[int, Episode]
    """by index: without a row so far"""
    text: bytearray = field(default_factory=bytearray)


class Players:
    """Plays groups in child processes. They are forked from this one, which must have no thread and
    no running loop; what it has imported and compiled they need not."""

    def __init__(self, study: Study, workers: int, allowance: Allowance = for_torn_cables) -> None:
        self._study, self._workers, self._allowance = study, workers, allowance
        self._running: list[_Process] = []

    def play(self, groups: Sequence[Group]) -> Iterator[Row]:
        """One row for each episode, as they come. Whoever stops listening ends the processes."""
        left = deque(groups)
        try:
            with selectors.DefaultSelector() as selector:
                while left or self._running:
                    while left and len(self._running) < self._workers:
                        process = self._start(left.popleft())
                        self._running.append(process)
                        selector.register(process.pipe, selectors.EVENT_READ, process)
                    for key, _ in selector.select():
                        yield from self._hear(key.data, selector)
        finally:
            self._end()

    def _start(self, group: Group) -> _Process:
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
                # A group is over before what it leaves behind is worth looking for.
                gc.disable()
                play_group(group, self._study, lambda row: _write(theirs, row), self._allowance)
                code = 0
            finally:
                os._exit(code)
        os.close(theirs)
        return _Process(number, ours, {each.index: each for each in group.episodes})

    def _hear(self, process: _Process, selector: selectors.BaseSelector) -> Iterator[Row]:
        data = os.read(process.pipe, _CHUNK)
        process.text += data
        *lines, rest = bytes(process.text).split(b"\n")
        process.text = bytearray(rest)
        for line in lines:
            row: Row = json.loads(line)
            process.waiting.pop(row["index"], None)
            yield row
        if data:
            return
        selector.unregister(process.pipe)
        os.close(process.pipe)
        _, status = os.waitpid(process.number, 0)
        self._running.remove(process)
        why = cause(os.waitstatus_to_exitcode(status), self._study.times.hang)
        for episode in process.waiting.values():
            yield failed(episode, "exception", f"in bring-up: {why}")

    def _end(self) -> None:
        for process in self._running:
            os.kill(process.number, signal.SIGKILL)
            os.waitpid(process.number, 0)
            os.close(process.pipe)
        self._running.clear()


def _write(pipe: int, row: Row) -> None:
    data = json.dumps(row, separators=(",", ":")).encode() + b"\n"
    while data:
        data = data[os.write(pipe, data) :]
