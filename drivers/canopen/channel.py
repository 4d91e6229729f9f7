"""One CAN channel: frames out, and frames in, by a table from identifier to handler."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Protocol

import can
import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import Channel as ChannelSection
from tonus.config.schema.bus import Master
from tonus.drivers.canopen.frames import (
    ERROR,
    EXTENDED,
    IDENTIFIER,
    REMOTE,
    FramesTogether,
    data_of,
    frames_of,
)
from tonus.drivers.canopen.health import Health
from tonus.drivers.canopen.identifiers import SYNC
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.canopen.stamps import Stamps
from tonus.drivers.canopen.syncs import FRAME_BITS, INTERFRAME_BITS, Arrival
from tonus.drivers.events import EventLog
from tonus.drivers.fieldbus import RAW_FRAME, FrameTap

Handler = Callable[[bytes], None]
Clock = Callable[[], int]

_SYNC = ((SYNC, b""),)
NO_FRAMES = np.zeros(0, RAW_FRAME)
_EMPTY_BITS = FRAME_BITS + INTERFRAME_BITS


def bits_of(frames: Sequence[tuple[int, bytes]]) -> int:
    """On the wire, the spaces behind the frames included, stuff bits not."""
    bits = len(frames) * _EMPTY_BITS
    for _, data in frames:
        bits += 8 * len(data)
    return bits


class Wires(Protocol):
    """Of a configuration, what concerns its channels."""

    @property
    def bitrate(self) -> int: ...
    @property
    def master(self) -> Master: ...
    @property
    def channels(self) -> tuple[ChannelSection, ...]: ...


class Channel:
    """Sends to one python-can bus and takes from it; never waits."""

    def __init__(
        self,
        number: int,
        bus: can.BusABC,
        config: Wires,
        period_us: int,
        fresh_ticks: int,
        clock: Clock,
        tap: FrameTap | None,
        events: EventLog,
        reception: Reception,
    ) -> None:
        """The ``number``-th of the channels of ``reception``."""
        self.name = config.channels[number].name
        self.handlers: dict[int, Handler] = {}
        self.arrivals: list[Arrival] = []
        """of every node on the channel"""
        self.syncs = reception.syncs[number]
        self.health = Health(self.name, bus, events)
        self.number = number
        self.bus = bus
        self._frames = frames_of(bus)
        self._together = self._frames if isinstance(self._frames, FramesTogether) else None
        self._clock = clock
        self._tap = tap
        self._events = events
        per_period = config.bitrate * period_us // 1_000_000
        self.frames_per_drain = config.master.drain_periods * (1 + per_period // _EMPTY_BITS)
        self._bit_ns = 1_000_000_000 // config.bitrate
        self._free_ns = 0
        """when all that was sent, and the answers to the last SYNC, have been on the wire"""
        self._fresh_ticks = fresh_ticks
        self._flood_frames = config.master.flood_frames
        self._flood_ticks = config.master.flood_ticks
        self._floods = 0
        self._foreign_frames = 0
        """since frames were taken last"""
        self._answers = self._answers_ns = 0
        """to a SYNC, and their time on the wire"""
        self._stalled = False
        self._unsent = 0  # SYNCs in a row
        self._stamps = Stamps()
        self._refused = False
        self._deaf = False

    def send(self, identifier: int, data: bytes) -> None:
        self._transmit(((identifier, data),), self._clock())

    def send_all(self, frames: Sequence[tuple[int, bytes]], now: int | None = None) -> None:
        """Identifiers and data, in one go where the bus can; ``now`` as in `sync`."""
        self._transmit(frames, self._present(now))

    def sync(self, tick: int, now: int | None = None) -> None:
        """``now``: one time for the frames of all channels, which a bus in software keeps to. On
        wires each has its own."""
        now, free_ns = self._present(now), self._free_ns
        if self._transmit(_SYNC, now):
            self._book_sync(tick, now, free_ns)
        else:
            self._unsent += 1

    def sync_was_sent(self, tick: int, now: int) -> None:
        """`sync`, sent in one call with those of other channels."""
        free_ns = self._free_ns
        self.book(_EMPTY_BITS, now)
        self._book_sync(tick, now, free_ns)

    def _present(self, now: int | None) -> int:
        return self._clock() if now is None or self._together is None else now

    def _book_sync(self, tick: int, now: int, free_ns: int) -> None:
        """A SYNC has been sent; ``free_ns``: when all that was sent before it has been."""
        self._unsent = 0
        self.syncs.bit_ns = self._bit_ns if self._stamps.exact else 0
        self.syncs.sent(tick, now, max(self._clock(), free_ns) - now)
        if len(self.arrivals) != self._answers:
            self._answers = len(self.arrivals)
            self._answers_ns = self._bit_ns * sum(each.frame_bits for each in self.arrivals)
        self._free_ns += self._answers_ns

    def _transmit(self, frames: Sequence[tuple[int, bytes]], now: int) -> bool:
        """Whether all of ``frames`` could be sent. A bus that takes several at once takes all or
        none; on another one a frame that is refused keeps back no other. A bus in software is told
        the time: devices answer a SYNC from the instant it is on the wire."""
        done, together = 0, self._together is not None and len(frames) > 1
        try:
            if self._together is not None and together:
                self._together.send_frames(frames, now)
            else:
                for identifier, data in frames:
                    self._frames.send_frame(identifier, data, now)
                    done += 1
        except (can.CanError, OSError) as error:
            if done:
                self._book_sent(frames[:done], now)
            self._refused = True
            self._events.begin("transmit_refused", self.name, f"frame not sent: {error}")
            if not together and done + 1 < len(frames):
                self._transmit(frames[done + 1 :], now)
            return False
        self._book_sent(frames, now)
        return True

    def _book_sent(self, frames: Sequence[tuple[int, bytes]], now: int) -> None:
        self.book(bits_of(frames), now)
        if self._tap is not None:
            self._tap.sent(frames, self.number, now)

    def book(self, bits: int, now: int) -> None:
        """Frames of so many ``bits`` have been sent at ``now``."""
        if self._refused:
            self._refused = False
            self._events.end("transmit_refused", self.name)
        if self._free_ns < now:
            self._free_ns = now
        self._free_ns += bits * self._bit_ns

    def take(self) -> NDArray[np.void]:
        """What has arrived, by our clock."""
        now = self._clock()
        try:
            frames = self._frames.receive_frames(self.frames_per_drain)
        except (can.CanError, OSError) as error:
            self.cannot_receive(error)
            return NO_FRAMES
        self._heard_again()
        if len(frames) and not self._stamps.exact:
            frames = self._stamped(frames, now)
        return frames

    def cannot_receive(self, error: Exception) -> None:
        self._deaf = True
        self._events.begin("bus_deaf", self.name, f"cannot receive: {error}")

    def has_taken(self) -> None:
        """`take`, done for all channels in one call, by our clock."""
        self._stamps.exact = True
        self._heard_again()

    def _heard_again(self) -> None:
        if self._deaf:
            self._deaf = False
            self._events.end("bus_deaf", self.name)

    def taken(self, count: int) -> None:
        """``count`` frames of the last `take` have been handled."""
        foreign, self._foreign_frames = self._foreign_frames, 0
        if self._deaf:
            return
        if count >= self.frames_per_drain:
            foreign += self._flood_frames
        if foreign >= self._flood_frames:
            self._floods += 1
            if self._floods >= self._flood_ticks:
                text = (
                    f"{self._floods} ticks in a row had too many frames, or too many with "
                    "unknown COB-IDs"
                )
                self._events.begin("bus_flooded", self.name, text)
        elif self._floods:
            self._floods = 0
            self._events.end("bus_flooded", self.name)

    def discard_stale(self) -> None:
        """Where nobody has answered for longer than a measurement is fresh, drop what waits to be
        sent: torques among it must not act when the bus comes back. Later ones are 0 already."""
        patience = self._fresh_ticks - self._unsent
        for arrival in self.arrivals:
            if arrival.silence <= patience:
                if self._stalled:
                    self._stalled = False
                    self._events.end("bus_stalled", self.name)
                return
        if not self._stalled and self.arrivals:
            self._stalled = True
            text = f"no node answered for {self._fresh_ticks + 1} ticks"
            self._events.begin("bus_stalled", self.name, text)
            # Not every interface can; what it holds then acts once (docs/events.md).
            with contextlib.suppress(NotImplementedError, can.CanError, OSError):
                self.bus.flush_tx_buffer()

    def _stamped(self, frames: NDArray[np.void], now: int) -> NDArray[np.void]:
        """The same frames by our clock."""
        frames = frames.copy()
        stamps = frames["stamp_ns"]
        for i, (stamp, own) in enumerate(frames[["stamp_ns", "own"]].tolist()):
            if not own:
                stamps[i] = self._stamps.of(stamp, now)
        return frames

    def handle(self, frame: np.void, now: int) -> None:
        """Give one frame of a `take` to whoever it is for."""
        stamp, identifier, dlc, own, _, word = frame.item()
        if own:
            return
        self.syncs.stamp_ns = min(stamp, now) if stamp else now
        data = data_of(identifier, dlc, word)
        handler = self.handlers.get(identifier)  # a flag makes it an identifier of nobody
        if handler is not None:
            handler(data)
        elif identifier & ERROR:
            self.health.error_frame(identifier & IDENTIFIER, data)
        else:
            self._foreign(identifier, dlc)

    def _foreign(self, identifier: int, dlc: int) -> None:
        self._foreign_frames += 1
        kind = "remote request" if identifier & REMOTE else "frame"
        width = 8 if identifier & EXTENDED else 3
        number = f"0x{identifier & IDENTIFIER:0{width}X}"
        text = f"{kind} {number}, {dlc} bytes, belongs to no node of ours"
        self._events.counted("foreign_frame", f"{self.name}/{number}", text)

    def shutdown(self) -> None:
        try:
            self.bus.shutdown()
        except (can.CanError, OSError) as error:
            self._events.add("bus_deaf", self.name, f"did not close: {error}")
