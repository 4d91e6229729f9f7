"""What devices are told beside their process data, and what others send in the supervisor's
name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from tonus.config.schema.supervisor import Requirement
from tonus.runtime.supervisor.judge import NOWHERE, Violation
from tonus.runtime.supervisor.listener import Heard, Watched
from tonus.runtime.supervisor.wiring import Value

REQUEST, NMT = 0x600, 0x000
"""Identifiers (CiA 301): of SDO requests, with the node's number added, and of NMT commands"""
_NMT_BYTES = 2
_START = 0x01
"""a node, by NMT"""
_BEGINS, _GOES_ON, _EXPEDITED = (0x20, 0xC0), 0x00, 0x22
"""upper three bits of a request that begins a download, also in blocks, or goes on with one; and of
one that has its data in it, the second lowest too (CiA 301)"""
_POWER_OFF = 0x0060402B
"""the request to write 0 to the controlword, with which the daemon ends"""
_CONTROLWORD, _ENABLE = 0x6040, 0x0F
_EVERY_NODE = 0
_COPIES, _ONE_OF = 16, 64
"""of its own frames, that a bus may repeat: at most, and one more for each so many that it sends. A
stranger that holds drives sends three in the time of these"""


class Told(NamedTuple):
    """A device by its node, and what came of SDO requests to it and of NMT commands."""

    where: int
    """axis, or `NOWHERE`"""
    node: int
    requests: Heard
    commands: Heard
    started: bool
    """by the daemon at rest, as a relay's node is"""


class Own:
    """Frames that only the supervisor sends, on an interface that tells what it has sent."""

    def __init__(self, identifier: int, heard: Heard) -> None:
        self.identifier, self.heard = identifier, heard
        self.begin()

    def begin(self) -> None:
        """What was heard so far is over: it may be of a process before this one."""
        self._sent, self._until = self.heard.count, _ONE_OF

    def send(self) -> None:
        """One is sent."""
        self._until -= 1
        if not self._until:
            self._until = _ONE_OF
            self._sent += self.heard.count > self._sent
        self._sent += 1

    @property
    def foreign(self) -> bool:
        """More were heard than it has sent, and than copies explain."""
        return self.heard.count > self._sent + _COPIES


def told_by(nodes: Iterable[int]) -> list[Watched]:
    """What these nodes of a channel are told by. A request has 8 bytes (CiA 301); a device may take
    a shorter one all the same."""
    found = [Watched(REQUEST + node, 1, (Value(0, 64),), command=True) for node in nodes]
    return [*found, Watched(NMT, _NMT_BYTES, (Value(0, 16),), command=True)]


class Commands:
    """Looks at what has come since it was called last."""

    def __init__(self, told: list[Told], own: list[Own]) -> None:
        self._told, self._own = told, own
        self._open: set[int] = set()
        """where a download to the controlword has begun whose word comes later"""
        self.led: list[int] = []
        """where among what was found last was a controlword that may lead to power, which no daemon
        in order writes: it resets faults"""
        self.changed: Violation | None = None
        """among what was found last, a download to anything but the controlword, or a command of
        the network, but to start what the daemon starts at rest"""

    def __call__(self) -> Violation | None:
        """An NMT command, or a download but to switch the power off, by a stranger or by the
        daemon, which does so only while no drive is enabled; or a stranger's frame under an
        identifier of the supervisor's own."""
        found = None
        self.led, self.changed = [], None
        for each in self._told:
            for word in map(int, each.requests.numbers):
                begins = word & 0xE0 in _BEGINS
                if (begins or word & 0xE0 == _GOES_ON) and word != _POWER_OFF:
                    index = begins * (word >> 8 & 0xFFFF)  # what goes on names no object
                    found = Violation(Requirement.COMMANDED, each.where, index)
                    if self._leads_to_power(each.where, word, index):
                        self.led.append(each.where)
                    elif index != _CONTROLWORD:
                        self.changed = found
            for word in map(int, each.commands.numbers):
                code, node = word & 0xFF, word >> 8 & 0xFF
                if node in (_EVERY_NODE, each.node):
                    found = Violation(Requirement.COMMANDED, each.where, code)
                    if not (code == _START and each.started):
                        self.changed = found
        for each in self._told:
            each.requests.numbers.clear()
            each.commands.numbers.clear()
        if any(each.foreign for each in self._own):
            found = Violation(Requirement.COMMANDED, NOWHERE, 0.0)
        return found

    def _leads_to_power(self, where: int, word: int, index: int) -> bool:
        """A request that writes the controlword, or goes on with one that does."""
        if index == _CONTROLWORD and word & _EXPEDITED != _EXPEDITED:
            self._open.add(where)
        elif word & 0xE0 == _EXPEDITED & 0xE0:
            self._open.discard(where)
            return index == _CONTROLWORD and word >> 32 & _ENABLE != 0
        return where in self._open
