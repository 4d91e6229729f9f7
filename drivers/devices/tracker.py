"""The optical tracker: poses as datagrams (docs/tracker.md), from a socket or from the lab."""

from __future__ import annotations

import math
import socket
import struct
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tonus.drivers.errors import DriverError
from tonus.drivers.events import EventLog
from tonus.drivers.fieldbus import BusEvent
from tonus.drivers.process_image import ProcessImage

DATAGRAM = struct.Struct("<4sHHIIq3d4df")
MAGIC = b"TNTK"
VERSION = 1
PLATFORM = 0
"""Body number of the platform; other bodies are none of ours."""
POSE_VALID = 0x1
UNIT_TOLERANCE = 1e-3
"""How far a quaternion's norm may be from 1: single precision upstream stays well inside."""
PER_POLL = 64
"""Datagrams taken in one poll, so that a flood cannot hold the tick."""


class TrackerSource(Protocol):
    """Where datagrams come from."""

    def poll(self, now_ns: int) -> list[bytes]:
        """Everything that has arrived by ``now_ns``, oldest first; never waits. Raises `OSError`
        where nothing can be received."""

    def close(self) -> None: ...


class UdpTracker:
    """Datagrams from a UDP socket, of one sender: the first that is heard, until it is silent."""

    def __init__(
        self, address: str, port: int, silence_ms: float, events: EventLog | None = None
    ) -> None:
        """``silence_ms``: after which another sender is listened to; until then it is refused, as
        ``events`` tells. Raises `DriverError` if the port cannot be had."""
        self._silence_ns = round(silence_ms * 1e6)
        self._events = events or EventLog()
        self._sender: tuple[str, int] | None = None
        self._heard_ns = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._error: OSError | None = None
        try:
            self._socket.bind((address, port))
        except OSError as error:
            self._socket.close()
            raise DriverError(f"tracker port {address}:{port}: {error.strerror}") from error

    @property
    def port(self) -> int:
        port: int = self._socket.getsockname()[1]
        return port

    def poll(self, now_ns: int) -> list[bytes]:
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        datagrams: list[bytes] = []
        for _ in range(PER_POLL):
            try:
                datagram, sender = self._socket.recvfrom(2 * DATAGRAM.size)
            except BlockingIOError:
                break
            except OSError as error:
                if not datagrams:
                    raise
                self._error = error  # the kernel tells it once; what came before it is not lost
                break
            if self._listens_to(sender, now_ns):
                datagrams.append(datagram)
        return datagrams

    def _listens_to(self, sender: tuple[str, int], now_ns: int) -> bool:
        first = self._sender
        if first is not None and first != sender and now_ns - self._heard_ns <= self._silence_ns:
            other, own = (f"{host}:{port}" for host, port in (sender, first))
            self._events.counted(
                "tracker_second_sender", "tracker", f"{other} sends poses too; {own} is listened to"
            )
            return False
        self._sender, self._heard_ns = sender, now_ns
        return True

    def close(self) -> None:
        self._socket.close()


@dataclass(frozen=True)
class Pose:
    """One datagram's content; ``timestamp_ns`` is the instant of exposure on the robot's clock."""

    sequence: int
    timestamp_ns: int
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class MalformedError(DriverError):
    """A datagram that cannot be believed; the text says why."""


def parse(datagram: bytes) -> Pose | None:
    """The platform's pose; None for another body or while the tracker does not see it.

    Raises `MalformedError`.
    """
    if len(datagram) != DATAGRAM.size:
        raise MalformedError(f"{len(datagram)} bytes instead of {DATAGRAM.size}")
    magic, version, body, sequence, flags, timestamp, x, y, z, qw, qx, qy, qz, _ = DATAGRAM.unpack(
        datagram
    )
    if magic != MAGIC:
        raise MalformedError("does not begin with TNTK")
    if version != VERSION:
        raise MalformedError(f"version {version}, known is {VERSION}")
    if body != PLATFORM or not flags & POSE_VALID:
        return None
    if not all(map(math.isfinite, (x, y, z, qw, qx, qy, qz))):
        raise MalformedError("a pose that is not finite")
    norm = math.hypot(qw, qx, qy, qz)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise MalformedError(f"a quaternion of norm {norm:.4g}")
    return Pose(sequence, timestamp, (x, y, z), (qw, qx, qy, qz))


class TrackerInput:
    """Puts the newest pose into the image's tracker row."""

    def __init__(
        self, image: ProcessImage, source: TrackerSource, events: EventLog | None = None
    ) -> None:
        """``events``: where the ``source`` tells what it refuses."""
        self._row = image.tracker
        self._source = source
        self._events = events or EventLog()
        self._newest: int | None = None
        self.malformed = 0
        """datagrams that were not believed, so far"""
        self.failures = 0
        """polls in which nothing could be received, so far"""

    def collect(self, now_ns: int) -> None:
        """Take what has arrived by ``now_ns``; a pose older than the one held is passed over.

        ``now_ns`` is what the clock reads, not when the tick was due: a pose exposed while a tick
        was late is not from the future.
        """
        row = self._row
        row["fresh"] = 0
        newest: Pose | None = None
        for datagram in self._received(now_ns):
            try:
                pose = parse(datagram)
                if pose is not None and pose.timestamp_ns > now_ns:
                    raise MalformedError("a pose from the future: its clock is not the robot's")
            except MalformedError as error:
                self.malformed += 1
                self._events.counted("tracker_malformed", "tracker", str(error))
                continue
            if pose is not None and (self._newest is None or pose.timestamp_ns > self._newest):
                self._newest = pose.timestamp_ns
                newest = pose
        if newest is not None:
            row["position"] = newest.position
            row["quaternion"] = newest.quaternion
            row["sequence"] = newest.sequence
            row["fresh"] = 1
        if self._newest is not None:
            row["delay"] = np.float64((now_ns - self._newest) * 1e-9)

    def _received(self, now_ns: int) -> list[bytes]:
        """A failing socket must not end a tick: the cables hold the robot without the tracker."""
        try:
            return self._source.poll(now_ns)
        except OSError as error:
            self.failures += 1
            text = f"cannot receive: {error.strerror or error}"
            self._events.counted("tracker_receive_failure", "tracker", text, kind=error.errno)
            return []

    def take_events(self) -> list[BusEvent]:
        return self._events.take()

    def close(self) -> None:
        self._source.close()
