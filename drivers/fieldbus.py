"""The door between control and any bus: bring up, collect, publish, object access, stop."""

from __future__ import annotations

from collections.abc import Callable
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
        ("own", "u1"),  # sent by ourselves
        ("padding", "<u2"),
        ("data", "<i8"),  # eight bytes as they come
    ]
)
"""A CAN frame as it is read."""


class FrameTap(Protocol):
    """Hears every frame of every channel. Times are ns of the loop's clock."""

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        """One frame; ``sent`` by us."""

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        """Frames (n,) of `RAW_FRAME` that have been read by ``now_ns``, those of our own left out;
        one without a stamp, or with a later one, came now."""


@dataclass(frozen=True)
class BusEvent:
    """Something a person should read later: which node, what, in words."""

    name: str
    """one of `tonus.drivers.events.EVENTS`"""
    where: str
    """channel and node, as in can1/3"""
    text: str
    """what happened, and what is done about it"""


class Fieldbus(Protocol):
    """A bus with every device on it.

    In a tick: `collect` first (fills ``image`` with all that has arrived, then triggers the
    devices' next exchange), `publish` as soon as the outputs are computed. Neither waits.
    A value sampled in tick k is read in tick k+1; a torque written in k+1 acts in tick k+2.
    """

    image: ProcessImage
    channels: tuple[str, ...]

    async def start(self, progress: Progress) -> None:
        """Bring every device to the state in which `collect` and `publish` work.

        Raises a `DriverError` that names each device that failed and why.
        """

    def collect(self, tick: int) -> None: ...

    def publish(self, tick: int) -> None: ...

    def take_events(self) -> list[BusEvent]:
        """Events since the last call; empty, and free, almost always."""

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes: ...

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None: ...

    async def recover(self) -> None:
        """Bring back, while ticks go on, every device that restarted, left operation or holds an
        error that a controlword alone does not clear. What cannot be brought back is an event.
        """

    async def stop(self) -> None:
        """Leave the devices safe (disabled, pre-operational) and release the bus."""
