"""What goes out on all channels of a fieldbus at one instant, in one call where their buses can be
joined; and what came in on them, booked and recorded together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import can
import numpy as np
from numpy.typing import NDArray

from tonus.drivers.canopen.channel import NO_FRAMES, Channel, bits_of
from tonus.drivers.canopen.frames import joined
from tonus.drivers.canopen.identifiers import SYNC
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.fieldbus import RAW_FRAME, FrameTap


class Batch:
    """Frames that are sent again and again, each time with other data of the same length."""

    def __init__(self, frames: Sequence[tuple[int, int, int]]) -> None:
        """Channel, identifier and length of each; those of a channel one behind the other."""
        self._frames = np.zeros(len(frames), RAW_FRAME)
        self._words = self._frames["data"].view(np.uint64)
        self._stamps = self._frames["stamp_ns"]
        self._data = [bytes(size) for _, _, size in frames]
        self._filled = False
        self._of_channel: dict[int, list[tuple[int, int]]] = {}
        """place and identifier of each frame"""
        for place, (channel, identifier, size) in enumerate(frames):
            self._frames[place] = (0, identifier, size, 0, channel, 0)
            self._of_channel.setdefault(channel, []).append((place, identifier))
        self.bits = {channel: bits_of(self.of(channel)) for channel in self._of_channel}
        """on the wire of each channel"""

    def fill(self, data: list[bytes]) -> None:
        """With the data of each."""
        self._data, self._filled = data, True

    def of(self, channel: int) -> list[tuple[int, bytes]]:
        """Identifiers and data of a channel's frames."""
        return [(identifier, self._data[place]) for place, identifier in self._of_channel[channel]]

    def together(self, sent_ns: int) -> NDArray[np.void]:
        """All of them, (n,) of `RAW_FRAME`, valid until the next call."""
        self._stamps[:] = sent_ns
        if self._filled:
            self._words[:] = [int.from_bytes(data, "little") for data in self._data]
            self._filled = False
        return self._frames


class Channels:
    """``channels`` in their order, all those of one ``reception``; ``tap`` hears of every frame."""

    def __init__(
        self,
        channels: Sequence[Channel],
        clock: Callable[[], int],
        tap: FrameTap | None,
        reception: Reception,
    ) -> None:
        self._channels = channels
        self._clock, self._tap, self._reception = clock, tap, reception
        self._numbers = np.arange(len(channels), dtype=np.uint16)
        self._joined = joined([channel.bus for channel in channels])
        per_drain = [channel.frames_per_drain for channel in channels]
        self._frames_per_drain, self._few = sum(per_drain), min(per_drain)
        self._none = [0] * len(channels)
        self._sync = Batch([(number, SYNC, 0) for number in range(len(channels))])

    def send(self, batch: Batch) -> None:
        now = self._clock()
        if self._send_joined(batch, now):
            for number, bits in batch.bits.items():
                self._channels[number].book(bits, now)
        else:
            for number in batch.bits:
                self._channels[number].send_all(batch.of(number), now)

    def drain(self) -> None:
        """Hand every frame that has arrived to its handler, channel by channel."""
        frames, counts = self._take()
        count = len(frames)
        if count:
            now = self._clock()
            if self._tap is not None:
                self._tap.received(frames, 0, now)
            receive = self._reception
            at = receive(frames, 0, now)
            while at < count:
                frame = frames[at]
                self._channels[frame["channel"]].handle(frame, now)
                at = receive(frames, at + 1, now)
        for channel, of_channel in zip(self._channels, counts, strict=True):
            channel.taken(of_channel)

    def _take(self) -> tuple[NDArray[np.void], list[int]]:
        """What has arrived, and how many frames on each channel, where that may be too many."""
        together = self._take_joined()
        if together is not None:
            if len(together) < self._few:  # so none has too many
                return together, self._none
            by_channel = np.bincount(together["channel"], minlength=len(self._channels))
            return together, by_channel.tolist()
        arrived = [channel.take() for channel in self._channels]
        counts = [len(frames) for frames in arrived]
        # A twentieth of what numpy takes to concatenate records.
        frames = np.frombuffer(bytearray().join([each.data for each in arrived]), RAW_FRAME)
        frames["channel"] = self._numbers.repeat(counts)
        return frames, counts

    def _take_joined(self) -> NDArray[np.void] | None:
        if self._joined is None:
            return None
        try:
            frames = self._joined.receive_joined(self._frames_per_drain)
        except (can.CanError, OSError) as error:
            for channel in self._channels:
                channel.cannot_receive(error)
            return NO_FRAMES
        if frames is not None:
            for channel in self._channels:
                channel.has_taken()
        return frames

    def sync(self, tick: int) -> None:
        """A SYNC on each."""
        now = self._clock()
        if self._send_joined(self._sync, now):
            for channel in self._channels:
                channel.sync_was_sent(tick, now)
        else:
            for channel in self._channels:
                channel.sync(tick, now)

    def _send_joined(self, batch: Batch, now: int) -> bool:
        if self._joined is None:
            return False
        frames = batch.together(now)
        try:
            if not self._joined.send_joined(frames, now):
                return False
        except (can.CanError, OSError):
            return False  # each channel meets it, and tells
        if self._tap is not None:
            self._tap.sent_together(frames, 0, now)
        return True
