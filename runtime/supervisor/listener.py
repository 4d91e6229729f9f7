"""One CAN channel, read for the supervisor alone: the newest frame of each identifier."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import can
import numpy as np
from can.interfaces.socketcan import SocketcanBus
from numpy.typing import NDArray

from tonus.runtime.supervisor.wiring import Value

_CAN_FRAME = struct.Struct("<IB3xQ")
"""struct can_frame of linux/can.h"""
_MOST = 4096
"""frames of one look: a flood must not hold the supervisor"""
Arrived = Iterable[tuple[tuple[int, int], int]]
"""Identifier and length, and data as a little-endian word, of every frame that has arrived."""
Fetch = Callable[[], Arrived]


STATE, _QUICK_STOP_ACTIVE, OPERATION_ENABLED = 0x6F, 0x07, 0x27
"""CiA 402, statusword"""
_STARTABLE = frozenset((0x21, 0x23))
"""ready to switch on, and switched on: a controlword alone leads to power"""
_FAULT_STATE, _FAULTS = 0x4F, frozenset((0x08, 0x0F))
"""fault, and the reaction to it"""
_ENABLE = 0x0F
"""of a controlword (CiA 402)"""
_COMMUNICATION = (0x81, 0x82)
"""CiA 301, error codes 0x81xx and 0x82xx: the bus is wrong, not what is measured"""
_POWERED = frozenset((OPERATION_ENABLED, _QUICK_STOP_ACTIVE))
_LARGEST_NUMBER = 2.0**32
"""of an integer in a PDO; a float beyond it is none, and would leave nothing of the sum's digits"""
_LONGEST = 8
"""bytes"""


class Watched(NamedTuple):
    """An identifier, the length its frames must have, the numbers that are summed, and the
    statusword or controlword where it is a drive's. A ``command`` may be longer: a drive acts on
    the part that it maps (CiA 301), of the newest at the next frame under ``sync``, where that is
    not 0. Of ``errors``, emergency frames, those about the bus are left out."""

    identifier: int
    size: int
    values: tuple[Value, ...]
    statusword: Value | None = None
    command: bool = False
    errors: bool = False
    sync: int = 0
    controlword: Value | None = None

    @property
    def sizes(self) -> range:
        """Lengths that are taken."""
        return range(self.size, (_LONGEST if self.command else self.size) + 1)


class Heard:
    """What was received under one identifier: the newest data, when it was read, how many frames,
    how many of them in a row had the first number of the one before, or all its data where they
    have none, the sum of each number, the frames of a drive that had power, or in which it was told
    to have it; of a command all this counts where it acts. And the first number of each frame since
    `numbers` was emptied last, whether it acted or not."""

    __slots__ = (
        "_newest",
        "at_ns",
        "controlword",
        "count",
        "numbers",
        "on",
        "same",
        "statusword",
        "totals",
        "values",
        "word",
    )

    def __init__(
        self,
        values: tuple[Value, ...],
        statusword: Value | None = None,
        controlword: Value | None = None,
    ) -> None:
        self.values, self.statusword, self.controlword = values, statusword, controlword
        self.word = self.at_ns = self.count = self.same = self.on = 0
        self._newest: float | None = None
        self.totals = [0.0] * len(values)
        self.numbers: deque[float] = deque(maxlen=_MOST)

    @property
    def powered(self) -> bool:
        """By the newest statusword: in quick stop a drive brakes, and may be enabled again. What
        it does in a reaction to a fault is its own, and ends by itself."""
        return self.statusword is not None and _powered(self.word, self.statusword)

    @property
    def in_quick_stop(self) -> bool:
        """By the newest statusword."""
        found = self.statusword
        return found is not None and self.word >> found.shift & STATE == _QUICK_STOP_ACTIVE

    @property
    def startable(self) -> bool:
        """By the newest statusword."""
        found = self.statusword
        return found is not None and self.word >> found.shift & STATE in _STARTABLE

    @property
    def failed(self) -> bool:
        """By the newest statusword: no command but a reset leads out of it."""
        found = self.statusword
        return found is not None and self.word >> found.shift & _FAULT_STATE in _FAULTS

    @property
    def enables(self) -> bool:
        """By the newest controlword."""
        return self.controlword is not None and _enables(self.word, self.controlword)

    @property
    def reports_error(self) -> bool:
        """Of emergency frames: the error code (CiA 301, two bytes) is one."""
        return self.word & 0xFFFF != 0

    def take(self, words: Sequence[int], now_ns: int) -> None:
        """The data of frames that were read at one time, in their order; at least one."""
        self.numbers.extend(self.act(words, now_ns))

    def send(self, words: Sequence[int]) -> None:
        """The data of commands, whether or not they act."""
        self.numbers.extend(self.values[0].numbers(words))

    def act(self, words: Sequence[int], now_ns: int) -> Sequence[float]:
        """`take`, but for `numbers`: the first number of each."""
        found = [value.numbers(words) for value in self.values]
        for each in found[0] if found else words:
            self.same = self.same + 1 if each == self._newest else 0
            self._newest = each
        self.word, self.at_ns = words[-1], now_ns
        self.count += len(words)
        if self.statusword is not None:
            self.on += sum(_powered(word, self.statusword) for word in words)
        if self.controlword is not None:
            self.on += sum(_enables(word, self.controlword) for word in words)
        for place, numbers in enumerate(found):  # the sum is for ever
            known = (number for number in numbers if abs(number) <= _LARGEST_NUMBER)
            self.totals[place] = sum(known, self.totals[place])
        return found[0] if found else ()


class Errors(Heard):
    """Emergency frames, of which the newest is kept that is about the device."""

    __slots__ = ()

    def take(self, words: Sequence[int], now_ns: int) -> None:
        """An error of the bus takes none of the device's back: only 0x0000 does (CiA 301)."""
        own = [word for word in words if word >> 8 & 0xFF not in _COMMUNICATION]
        super().take(own or [self.word], now_ns)


class _Command:
    """What one device is told under one identifier, until it acts."""

    __slots__ = ("acted", "heard", "sent", "told", "waiting")

    def __init__(self, heard: Heard) -> None:
        self.heard = heard
        self.sent: list[int] = []
        """since the last SYNC, or the last look"""
        self.told: list[int] = []
        """before that, and"""
        self.acted: list[int] = []
        """in this look"""
        self.waiting: int | None = None
        """the newest of before"""

    def hold(self) -> None:
        """The newest waits."""
        if self.sent:
            self.waiting = self.sent[-1]
            self.told += self.sent
            self.sent.clear()

    def sync(self) -> None:
        """It acts."""
        self.hold()
        if self.waiting is not None:
            self.acted.append(self.waiting)
            self.waiting = None

    def look(self, now_ns: int) -> None:
        """What came in a look is over."""
        self.hold()
        if self.told:
            self.heard.send(self.told)
            self.told.clear()
        if self.acted:
            self.heard.act(self.acted, now_ns)
            self.acted.clear()


class Listener:
    """A frame of another length than its PDO's is not taken."""

    def __init__(self, bus: can.BusABC, watched: Iterable[Watched]) -> None:
        self.bus = bus
        self.heard: dict[int, Heard] = {}
        self._arrived: dict[tuple[int, int], list[int]] = {}
        """data by identifier and length"""
        self._taken: list[tuple[Heard, list[int]]] = []
        self._commands: list[_Command] = []
        self._synced: dict[int, list[_Command]] = {}
        for each in watched:
            kind = Errors if each.errors else Heard
            heard = kind(each.values, each.statusword, each.controlword)
            self.heard[each.identifier] = heard
            words: list[int] = []
            if each.sync:
                command = _Command(heard)
                words = command.sent
                self._commands.append(command)
                self._synced.setdefault(each.sync, []).append(command)
            else:
                self._taken.append((heard, words))
            for size in each.sizes:
                self._arrived[each.identifier, size] = words
        self._fetch = _fetch(bus)

    def read(self, now_ns: int) -> None:
        """Raises `can.CanError` and OSError."""
        arrived, synced = self._arrived, self._synced
        try:
            for frame, word in self._fetch():
                words = arrived.get(frame)
                if words is not None:
                    words.append(word)
                if frame[0] in synced:
                    for command in synced[frame[0]]:
                        command.sync()
        finally:
            for command in self._commands:
                command.look(now_ns)
            for heard, words in self._taken:
                if words:
                    heard.take(words, now_ns)
                    words.clear()


def _powered(word: int, statusword: Value) -> bool:
    return word >> statusword.shift & STATE in _POWERED


def _enables(word: int, controlword: Value) -> bool:
    return word >> controlword.shift & _ENABLE == _ENABLE


def _fetch(bus: can.BusABC) -> Fetch:
    receive = getattr(bus, "receive_frames", None)
    if receive is not None:
        return lambda: _from_array(receive(_MOST))
    if isinstance(bus, SocketcanBus):
        return lambda: _from_kernel(bus)
    return lambda: _messages(bus)


def _from_array(frames: NDArray[np.void]) -> Arrived:
    words = frames["data"].view(np.uint64).tolist()
    kinds = zip(frames["identifier"].tolist(), frames["dlc"].tolist(), strict=True)
    return zip(kinds, words, strict=True)


def _from_kernel(bus: SocketcanBus) -> Arrived:
    """Without python-can's message, which takes longer than a millisecond has room for."""
    bus.socket.setblocking(False)
    for _ in range(_MOST):
        try:
            data = bus.socket.recv(_CAN_FRAME.size)
        except BlockingIOError:
            return
        identifier, size, word = _CAN_FRAME.unpack(data)
        yield (identifier, size), word


def _messages(bus: can.BusABC) -> Arrived:
    for _ in range(_MOST):
        message = bus.recv(timeout=0)
        if message is None:
            return
        if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
            word = int.from_bytes(message.data, "little")
            yield (message.arbitration_id, message.dlc), word
