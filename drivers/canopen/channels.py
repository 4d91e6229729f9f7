"""What goes out on all channels of a fieldbus at one instant: in one call where their buses can be
joined, otherwise channel by channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tonus.drivers.canopen.channel import Channel, bits_of
from tonus.drivers.canopen.frames import joined
from tonus.drivers.canopen.identifiers import SYNC
from tonus.drivers.fieldbus import RAW_FRAME, FrameTap


class Batch:
    """Frames that are sent again and again, each time with other data of the same length."""

    def __init__(self, frames: Sequence[tuple[int, int, int]]) -> None:
        """Channel, identifier and length of each; those of a channel one behind the other."""
        self.frames = np.zeros(len(frames), RAW_FRAME)
        for row, (channel, identifier, size) in zip(self.frames, frames, strict=True):
            row["channel"], row["identifier"], row["dlc"] = channel, identifier, size
        self._memory = self.frames.view(np.uint8).data
        first = RAW_FRAME.fields["data"][1] if RAW_FRAME.fields is not None else 0
        self._places = [
            slice(at, at + size)
            for at, (_, _, size) in zip(
                range(first, self.frames.nbytes, RAW_FRAME.itemsize), frames, strict=True
            )
        ]
        self._identifiers: dict[int, list[tuple[int, slice]]] = {}
        for (channel, identifier, _), place in zip(frames, self._places, strict=True):
            self._identifiers.setdefault(channel, []).append((identifier, place))
        self.bits = {channel: bits_of(self.of(channel)) for channel in self._identifiers}
        """on the wire of each channel"""

    def fill(self, data: Sequence[bytes]) -> None:
        """With the data of each."""
        memory = self._memory
        for place, each in zip(self._places, data, strict=True):
            memory[place] = each

    def of(self, channel: int) -> list[tuple[int, bytes]]:
        """Identifiers and data of a channel's frames."""
        memory = self._memory
        return [
            (identifier, bytes(memory[place])) for identifier, place in self._identifiers[channel]
        ]


class Channels:
    """``channels`` in their order; ``tap`` hears of every frame."""

    def __init__(
        self, channels: Sequence[Channel], clock: Callable[[], int], tap: FrameTap | None
    ) -> None:
        self._channels = channels
        self._clock, self._tap = clock, tap
        self._joined = joined([channel.bus for channel in channels])
        self._sync = Batch([(number, SYNC, 0) for number in range(len(channels))])

    def send(self, batch: Batch) -> None:
        now = self._clock()
        if self._send_joined(batch, now):
            for number, bits in batch.bits.items():
                self._channels[number].book(bits, now)
        else:
            for number in batch.bits:
                self._channels[number].send_all(batch.of(number))

    def sync(self, tick: int) -> None:
        """A SYNC on each."""
        now = self._clock()
        if self._send_joined(self._sync, now):
            for channel in self._channels:
                channel.sync_was_sent(tick, now)
        else:
            for channel in self._channels:
                channel.sync(tick)

    def _send_joined(self, batch: Batch, now: int) -> bool:
        if self._joined is None or not self._joined.send_joined(batch.frames, now):
            return False
        if self._tap is not None:
            self._tap.sent_together(batch.frames, 0, now)
        return True
