"""The fieldbus without frames: same quantities, quantisation and delay, for campaigns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import DirectBus
from tonus.config.schema.root import Config
from tonus.drivers.cia301.setting import apply
from tonus.drivers.devices.drive import settings
from tonus.drivers.errors import BringUpError, DriverError, SdoError
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.fieldbus import BusEvent, Progress
from tonus.drivers.process_image import ProcessImage

Integers = NDArray[np.int64]
Words = Sequence[int] | Integers


class DirectPort(Protocol):
    """The far side: every device at once, in device units."""

    def exchange(
        self, at_ns: int, controlwords: Words, torques: Words
    ) -> tuple[Integers, Integers, Integers, Integers]:
        """At ``at_ns`` every device samples, then applies its controlword and per mille of torque:
        what a SYNC does on CAN. Returns statuswords, increments, per mille, process values."""

    def read(self, axis: int, index: int, subindex: int) -> bytes: ...

    def write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        """Both raise `LookupError` or `ValueError` where an SDO server would abort."""


class DirectFieldbus:
    """A `Fieldbus` on a `DirectPort`."""

    def __init__(
        self, config: Config, image: ProcessImage, port: DirectPort, clock: Callable[[], int]
    ) -> None:
        """``clock`` gives ns on the port's own time."""
        if not isinstance(config.fieldbus, DirectBus):
            raise DriverError(f"fieldbus kind {config.fieldbus.kind} is not direct")
        self.image = image
        self.channels: tuple[str, ...] = ()
        self._port = port
        self._clock = clock
        self._profiles = [config.fieldbus.profile(axis) for axis in range(config.robot.cables)]
        self._settings = [
            settings(train, profile)
            for train, profile in zip(config.robot.drive_trains, self._profiles, strict=True)
        ]
        self._cables = config.robot.cables
        self._offset_ns = round(config.fieldbus.sample_offset_us * 1000)
        self._events = EventLog()
        self._exchange = Exchange(
            config.robot,
            config.fieldbus.force_cell,
            config.control.freshness,
            image,
            self._events,
            [f"direct/{axis}" for axis in range(self._cables)],
        )
        self._off = np.zeros(self._cables, np.int64)
        self._commands = (self._off, self._off)
        self._sampled: tuple[int, int, Integers, Integers, Integers, Integers] | None = None
        """tick and time of the last exchange, and its samples"""

    async def start(self, progress: Progress) -> None:
        """Raises `BringUpError`, one line that names every axis that failed and why."""
        self._exchange.forget()
        self._commands = (self._off, self._off)
        failed = []
        for axis in range(self._cables):
            try:
                access = _Objects(self._port, axis)
                await apply(access, self._settings[axis])
                await self._exchange.read_scale(axis, access, self._profiles[axis])
            except DriverError as error:
                failed.append(f"axis {axis}: {error}")
        if failed:
            raise BringUpError(
                f"{len(failed)} of {self._cables} drives could not be configured: "
                + "; ".join(failed)
            )
        progress(f"{self._cables} drives are configured")

    def collect(self, tick: int) -> None:
        exchange = self._exchange
        if self._sampled is not None:
            sampled, sampled_ns, statuswords, positions, torques, cells = self._sampled
            exchange.sampled_ns.fill(sampled_ns)
            exchange.statuswords[:] = statuswords
            exchange.positions[:] = positions
            exchange.torques[:] = torques
            exchange.cells[:] = cells
            exchange.axis_tick.fill(sampled)
            exchange.cell_tick.fill(sampled)
        exchange.fill(tick)
        now_ns = self._clock()
        samples = self._port.exchange(now_ns + self._offset_ns, *self._commands)
        self._sampled = (tick, now_ns, *samples)

    def publish(self, tick: int) -> None:
        del tick  # the exchange of the next collect takes them, whenever that is
        self._commands = self._exchange.outputs()

    def take_events(self) -> list[BusEvent]:
        return self._events.take()

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        return await _Objects(self._port, axis).read(index, subindex)

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        await _Objects(self._port, axis).write(index, subindex, data)

    async def recover(self) -> None:
        """There are no nodes that could be brought back."""

    async def stop(self) -> None:
        """Power off with one last exchange."""
        if self._sampled is not None:
            self._sampled = None
            self._port.exchange(self._clock() + self._offset_ns, self._off, self._off)


class _Objects:
    """One axis of a port as `ObjectAccess`."""

    def __init__(self, port: DirectPort, axis: int) -> None:
        self._port = port
        self._axis = axis

    async def read(self, index: int, subindex: int) -> bytes:
        try:
            return self._port.read(self._axis, index, subindex)
        except (LookupError, ValueError) as error:
            raise SdoError(f"reading 0x{index:04X}:{subindex}: {error}") from error

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        try:
            self._port.write(self._axis, index, subindex, data)
        except (LookupError, ValueError) as error:
            raise SdoError(f"writing 0x{index:04X}:{subindex}: {error}") from error
