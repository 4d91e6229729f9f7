"""The interface between control and any bus: bring-up, collect, publish, object access, stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.process_image import ProcessImage

Progress = Callable[[str], None]
"""Called with one short line for each step of a bring-up."""

RAW_FRAME = np.dtype(
    [
        ("stamp_ns", "<i8"),  # of reception, 0 if the bus has none
        ("identifier", "<u4"),  # with SocketCAN's flags: 31 extended, 30 remote, 29 error
        ("dlc", "u1"),
        ("own", "u1"),  # sent by this program
        ("channel", "<u2"),  # of frames of several channels in one array, counted from the first
        ("data", "<i8"),  # eight bytes as they come
    ]
)
"""A CAN frame as the master and the taps use it."""


class FrameTap(Protocol):
    """Receives every frame of every channel. Times are ns of the loop's clock; ``channel`` counts
    from 0 in the order of `Fieldbus.channels`."""

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        """One frame; ``sent``: by this program. ``data`` has at most 8 bytes."""

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None:
        """Frames that this program has sent at ``now_ns``: identifier and data of each."""

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        """The same of frames (n,) of `RAW_FRAME`, the first of whose channels is ``channel``."""

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        """Frames (n,) of `RAW_FRAME`, read until ``now_ns``, without those of this program, the
        first of whose channels is ``channel``; a frame without a timestamp, or with a later one,
        counts as received at ``now_ns``."""


@dataclass(frozen=True)
class BusEvent:
    """One event of a bus, with the node and a text, for log and terminal."""

    name: str
    """one of `tonus.drivers.events.EVENTS`"""
    where: str
    """channel and node, as in can1/3"""
    text: str
    """what happened, and the reaction"""


class Fieldbus(Protocol):
    """A bus with every device on it.

    In a tick: `collect` first (fills ``image`` with all received values, then triggers the
    devices' next exchange), `publish` as soon as the outputs are computed. Neither waits nor raises
    for a device that does not answer: its measurement ages and the reason is an event.
    A value sampled in tick k is read in tick k+1; a torque written in k+1 acts in tick k+2.
    """

    image: ProcessImage
    """inputs and outputs, one row for each axis or cell, in SI units"""
    channels: tuple[str, ...]
    """names of the channels, or of the interfaces"""

    async def start(self, progress: Progress) -> None:
        """Bring every device to the state in which `collect` and `publish` work.

        Raises a `DriverError` that names each failed device and the reason.
        """

    def collect(self, tick: int) -> None:
        """Fill the inputs of ``image``, then trigger the exchange of ``tick`` (CAN: the SYNC)."""

    def publish(self, tick: int) -> None:
        """Send the outputs of ``image``; a torque that is not finite is sent as 0."""

    def take_events(self) -> list[BusEvent]:
        """Events since the last call, usually none."""

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        """Read an object of an axis' drive (CiA 301, SDO upload; EtherCAT: CoE); the bytes are
        little-endian. Raises a `DriverError` with the abort code, or after the timeout."""

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object of an axis' drive (SDO download). Raises as `sdo_read`."""

    async def recover(self) -> None:
        """Recover, while ticks go on, every device that restarted, left operation or has an error
        that a controlword alone does not clear. A device that cannot be recovered is an event.
        """

    async def stop(self) -> None:
        """Leave the devices safe (disabled, pre-operational) and release the bus."""
