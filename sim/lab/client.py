"""A connection to a channel of the lab, and what has come by it."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import repeat
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.sim.can import packet
from tonus.sim.can.joined import JoinedBuses
from tonus.sim.can.registry import Advancing
from tonus.sim.can.wire.channel import Channel
from tonus.sim.can.wire.frame import BASE_ID
from tonus.sim.can.wire.inbox import FRAMES
from tonus.sim.can.wire.port import Port
from tonus.sim.can.wire.regular import WireTable

_MOST_BYTES = 8
sent_ns = attrgetter("sent_ns")


class Sent(NamedTuple):
    """A frame of a client."""

    sent_ns: int
    client: Client
    identifier: int
    dlc: int
    data: bytes


class SentTogether(NamedTuple):
    """Plain data frames of a carrier, all sent at one time: (n,) of `FRAMES`."""

    sent_ns: int
    client: Client
    frames: NDArray[np.void]
    most: int
    """of one channel"""


class Client:
    """``members`` are the connections whose frames its packets have; beside a carrier that is this
    one alone."""

    def __init__(self, connection: socket.socket, channel: Channel) -> None:
        self.connection = connection
        self.port: Port = channel.attach(listens=True)
        self.port.reports = True
        self.waiting: list[Sent] = []
        """frames that have been read and found no room"""
        self.gather_ns = 0
        self.sent_ns = 0
        self.carrier = self
        self.members = [self]
        self.joined: JoinedBuses | None = None
        self._wishes = packet.Wishes()
        self._left = self._apart = False

    def wish(self, wishes: packet.Wishes, others: list[Client], lab: Advancing) -> None:
        """Let it be so. Of ``others`` those may be whose carrier this one has."""
        self.port.channel.hand_out()  # what has ended before
        self.port.echo = wishes.echo
        self.gather_ns = 1_000_000 * wishes.gather_ms
        self._wishes = wishes
        if wishes.connections:
            alike = [each for each in others if each._with(wishes)]
            if len(alike) == wishes.connections:
                alike.sort(key=lambda each: each._wishes.number)
                alike[0]._carry(alike, lab)

    def _with(self, wishes: packet.Wishes) -> bool:
        mine = self._wishes
        return (mine.connections, mine.shared) == (wishes.connections, wishes.shared)

    def _carry(self, members: list[Client], lab: Advancing) -> None:
        if [each._wishes.number for each in members] != list(range(len(members))):
            return
        try:
            self.connection.send(packet.AGREED)
        except OSError:
            return  # each has its own packets, as before
        self.members = members
        self.joined = JoinedBuses(lab, [member.port for member in members])
        for member in members:
            member.carrier = self

    def leave(self) -> None:
        """Without their carrier its members have their own packets again."""
        self.port.channel.detach(self.port)
        self._left = True
        self.carrier.joined = None
        if self.carrier is self:
            for member in self.members:
                member.carrier = member

    def wait(self, sent: Sent) -> None:
        """There is no room for it. Its carrier's packets must not wait as well."""
        self.waiting.append(sent)
        carrier = self.carrier
        if len(carrier.members) > 1 and not carrier._apart:
            with suppress(OSError):  # it is full or closed: the next one that waits tells it again
                carrier.connection.send(packet.APART)
                carrier._apart = True

    def take_waiting(self) -> list[Sent]:
        """What found no room."""
        taken, self.waiting = self.waiting, []
        return taken

    @property
    def waits(self) -> bool:
        """Whether any channel of its packets has something waiting."""
        return any(member.waiting for member in self.members)

    @property
    def room(self) -> int:
        """for frames on one of its channels at least; 0 where it goes on to send to a full one"""
        members = self.members
        if len(members) > 1 and any(len(each.waiting) >= each.port.depth for each in members):
            return 0
        return max([member.port.room for member in members])

    @property
    def received(self) -> bool:
        """Whether there is anything to send it."""
        return any(member.port.received for member in self.members)

    def take(self) -> bytes:
        """All that it receives."""
        taken = []
        for member in self.members:
            received = member.port.received
            assert received is not None
            taken.append(received.take(len(received)))
        if len(taken) == 1:
            return taken[0].tobytes()
        frames = np.frombuffer(bytearray().join([each.data for each in taken]), FRAMES)
        counts = [len(each) for each in taken]
        frames["channel"] = np.arange(len(counts), dtype=np.uint16).repeat(counts)
        return frames.tobytes()

    def missed(self, data: bytes) -> None:
        """Part of a `take` could not be sent."""
        channels = np.frombuffer(data, FRAMES)["channel"]
        for number, member in enumerate(self.members):
            assert member.port.received is not None
            member.port.received.missed += int((channels == number).sum())

    def sent(self, data: bytes, now_ns: int, last_ns: int) -> list[Sent | SentTogether]:
        """What a packet that is read at ``now_ns`` has, at the time at which each frame was sent,
        but not before ``last_ns``: a client's own keep their order."""
        data = data[: len(data) - len(data) % FRAMES.itemsize]
        if self.joined is not None and data:
            frames = np.frombuffer(bytearray(data), FRAMES)
            stamp_ns, most = together(frames, len(self.members))
            if stamp_ns:
                return [SentTogether(max(min(stamp_ns, now_ns), last_ns), self, frames, most)]
        found: list[Sent | SentTogether] = []
        for stamp_ns, client, frame in self._addressed(data):
            last_ns = max(min(stamp_ns or now_ns, now_ns), last_ns)
            found.append(Sent(last_ns, client, *frame))
        return found

    def _addressed(self, data: bytes) -> Iterator[tuple[int, Client, tuple[int, int, bytes]]]:
        """Time, sender, and identifier, DLC and data of every frame whose sender is still there."""
        members = self.members
        channels: Iterable[int] = repeat(0)  # the only member's
        if len(members) > 1:
            channels = np.frombuffer(data, FRAMES)["channel"].tolist()
        for channel, frame in zip(channels, packet.decode(data), strict=False):
            if channel < len(members) and not members[channel]._left:
                stamp_ns, identifier, dlc, _, content = frame
                yield stamp_ns, members[channel], (identifier, dlc, content)


def apart(sent: SentTogether) -> list[Sent]:
    """Frame by frame."""
    addressed = sent.client._addressed(sent.frames.tobytes())
    return [Sent(sent.sent_ns, client, *frame) for _, client, frame in addressed]


def rehearse() -> None:
    """Load what is compiled, before anything waits for it."""
    frames, row = np.zeros(1, FRAMES), np.zeros(1, np.int64)
    together(frames, 1)
    WireTable(1, 1).put(row, row, frames, 0)


@njit(cache=True)
def together(frames: NDArray[np.void], channels: int) -> tuple[int, int]:
    """The one time at which all of ``frames``, one at least, were sent, and the most of them on one
    channel. Time 0: there is none, or not all are data frames of base identifiers on one of so many
    ``channels``."""
    stamp_ns, counts = frames[0].stamp_ns, np.zeros(channels, np.int64)
    for i in range(len(frames)):
        frame = frames[i]
        if frame.stamp_ns != stamp_ns or frame.identifier > BASE_ID:
            return 0, 0
        if frame.dlc > _MOST_BYTES or frame.channel >= channels:
            return 0, 0
        counts[frame.channel] += 1
    return int(stamp_ns), int(counts.max())
