"""Both ends of a ring as one port.

Every frame goes in at both ends. While the ring is closed, the first copy passes all slaves and
comes out at the far end, and nobody touches the second. Where it is open, each copy comes back to
the end it went in at, served by the slaves on its side. So every slave has served one of the two,
and together they are the answer.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from tonus.drivers.ethercat.frames import COUNTER_BYTES, FIRST_DATAGRAM, HEADER_BYTES, INDEX_AT
from tonus.drivers.ethercat.port import FrameCrossing, FramePort

_SOURCE_AT = 11
"""Last byte of the sender's address: it tells the copies apart."""
_LENGTH_AT = 6
_LENGTH, _MORE = 0x07FF, 0x8000
_SHORT = struct.Struct("<H")
_BACKLOG = 64


@dataclass
class _Copy:
    frame: bytes
    came: int
    """the end it came out at, 0 or 1"""
    served: list[bool]
    """by some slave, of each datagram"""


@dataclass
class _Out:
    """What was sent and is not answered yet."""

    places: list[tuple[int, int]]
    """where the data of each datagram starts and ends"""
    copies: dict[int, _Copy]
    """by the end they went in at; the last of each, where an earlier frame of this index is late"""


class RingPort:
    """A `FramePort` on two. Answers are joined datagram by datagram, which is right for datagrams
    that one slave each answers."""

    instant = False

    def __init__(self, near: FramePort, far: FramePort) -> None:
        self._ends = (near, far)
        self._out: dict[int, _Out] = {}
        self.turned: int | None = None

    def send(self, frame: bytes, after_ns: int = 0) -> None:
        self._out[frame[INDEX_AT]] = _Out(_datagrams(frame), {})
        for number, end in enumerate(self._ends):
            copy = bytearray(frame)
            copy[_SOURCE_AT] = number
            end.send(bytes(copy), after_ns)

    def receive(self) -> bytes | None:
        for number, end in enumerate(self._ends):
            while (frame := end.receive()) is not None:
                answer = self._take(frame, number)
                if answer is not None:
                    return answer
        return None

    def _take(self, frame: bytes, came: int) -> bytes | None:
        """The answer, if this copy makes it whole. One that lacks a slave waits for the other and
        is no answer by itself: it would have slaves silent because of one lost frame."""
        out = self._out.get(frame[INDEX_AT])
        if out is None or _datagrams(frame) != out.places:
            return None  # answered, another port's, or damaged
        places, copies = out.places, out.copies
        served = [frame[end : end + COUNTER_BYTES] != bytes(COUNTER_BYTES) for _, end in places]
        copies[frame[_SOURCE_AT]] = _Copy(frame, came, served)
        if len(copies) < len(self._ends) and not all(served):
            return None
        del self._out[frame[INDEX_AT]]
        (sent, first), *others = sorted(copies.items())
        self.turned = _turned(sent, first)
        answer = bytearray(first.frame)
        for _, other in others:
            for (start, end), there in zip(places, other.served, strict=True):
                if there:
                    answer[start : end + COUNTER_BYTES] = other.frame[start : end + COUNTER_BYTES]
        return bytes(answer)

    def close(self) -> None:
        for end in self._ends:
            end.close()


def injected_ring(through: FrameCrossing, clock: Callable[[], int]) -> RingPort:
    """The ring is a function; time is the loop's."""
    came: tuple[deque[bytes], deque[bytes]] = (deque(maxlen=_BACKLOG), deque(maxlen=_BACKLOG))
    return RingPort(*(_InjectedEnd(number, through, clock, came) for number in (0, 1)))


class _InjectedEnd:
    instant = True
    turned: int | None = None

    def __init__(
        self,
        number: int,
        through: FrameCrossing,
        clock: Callable[[], int],
        came: tuple[deque[bytes], deque[bytes]],
    ) -> None:
        self._number = number
        self._through = through
        self._clock = clock
        self._came = came

    def send(self, frame: bytes, after_ns: int = 0) -> None:
        answer = self._through(frame, self._clock() + after_ns, self._number)
        if answer is not None:
            self._came[answer[1]].append(answer[0])

    def receive(self) -> bytes | None:
        came = self._came[self._number]
        return came.popleft() if came else None

    def close(self) -> None:
        self._came[self._number].clear()


def _turned(sent: int, copy: _Copy) -> int | None:
    """How many datagrams slaves on the near side serve, if this copy came back to its own end."""
    if copy.came != sent:
        return None
    served = sum(copy.served)
    return len(copy.served) - served if sent else served


def _datagrams(frame: bytes) -> list[tuple[int, int]]:
    """Where the data of each starts and ends."""
    places = []
    at, more = FIRST_DATAGRAM, True
    while more and at + HEADER_BYTES + COUNTER_BYTES <= len(frame):
        (word,) = _SHORT.unpack_from(frame, at + _LENGTH_AT)
        start = at + HEADER_BYTES
        end = start + (word & _LENGTH)
        at, more = end + COUNTER_BYTES, bool(word & _MORE)
        if at <= len(frame):
            places.append((start, end))
    return places
