"""Devices on more than one fieldbus: all are collected, and published to, in the same tick."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import FieldbusSection, SeveralBuses
from tonus.config.schema.root import Config
from tonus.drivers.errors import DriverError
from tonus.drivers.fieldbus import BusEvent, Fieldbus, Progress
from tonus.drivers.process_image import AxisCommand, ProcessImage

Build = Callable[[Config, ProcessImage], Fieldbus]
"""Makes the fieldbus of a configuration with one bus, on an image of its own."""


@dataclass(frozen=True)
class _Part:
    bus: FieldbusSection
    fieldbus: Fieldbus
    axes: list[int]
    cells: list[int]


class SeveralFieldbuses:
    """A `Fieldbus` of fieldbuses, each with some of the axes and cells.

    Each part has a process image of its own, of which only its own rows are used. A bus whose
    master moves its devices' sampling to the loop (CANopen's SYNC) and one whose devices have
    clocks (EtherCAT's SYNC0) sample within the same tick; by how much apart is configuration.
    """

    def __init__(self, config: Config, image: ProcessImage, build: Build) -> None:
        """Raises `DriverError` for a part that control cannot work with."""
        if not isinstance(config.fieldbus, SeveralBuses):
            raise DriverError(f"fieldbus kind {config.fieldbus.kind} is not several")
        self.image = image
        self._parts = []
        # A segment's frame goes out after the others: in virtual time it passes later in the tick.
        for bus in sorted(config.fieldbus.buses, key=lambda each: each.sends_last):
            axes, cells = bus.devices
            image_of_part = ProcessImage(config.robot.cables)
            image_of_part.obstacles = image.obstacles
            part = build(config.model_copy(update={"fieldbus": bus}), image_of_part)
            part.image.commands["command"] = AxisCommand.DISABLE
            self._parts.append(_Part(bus, part, axes, cells))
        self.channels: tuple[str, ...] = tuple(
            name for part in self._parts for name in part.fieldbus.channels
        )
        self._of_axis = {axis: part.fieldbus for part in self._parts for axis in part.axes}

    async def start(self, progress: Progress) -> None:
        """One after the other; if one fails, those before it are stopped. Raises `DriverError`."""
        started: list[Fieldbus] = []
        try:
            for part in self._parts:
                started.append(part.fieldbus)
                await part.fieldbus.start(progress)
            started = []
        finally:
            # The error of the start is the first; none of stopping hides it.
            await _stopped(started)

    def collect(self, tick: int) -> None:
        image = self.image
        for part in self._parts:
            part.fieldbus.collect(tick)
            theirs = part.fieldbus.image
            _copy(theirs.axes, image.axes, part.axes)
            _copy(theirs.cells, image.cells, part.cells)
        image.supervisor_ignored = any(
            part.fieldbus.image.supervisor_ignored for part in self._parts
        )

    def publish(self, tick: int) -> None:
        for part in self._parts:
            _copy(self.image.commands, part.fieldbus.image.commands, part.axes)
            part.fieldbus.publish(tick)

    def take_events(self) -> list[BusEvent]:
        events: list[BusEvent] = []
        for part in self._parts:
            events += part.fieldbus.take_events()
        return events

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        return await self._of_axis[axis].sdo_read(axis, index, subindex)

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        await self._of_axis[axis].sdo_write(axis, index, subindex, data)

    async def recover(self) -> None:
        await asyncio.gather(*(part.fieldbus.recover() for part in self._parts))

    async def stop(self) -> None:
        """All at once, so that none waits for another; then the first one's error is raised."""
        errors = await _stopped([part.fieldbus for part in self._parts])
        if errors:
            raise errors[0]

    @property
    def parts(self) -> list[tuple[FieldbusSection, Fieldbus]]:
        """Each with its section."""
        return [(part.bus, part.fieldbus) for part in self._parts]


async def _stopped(fieldbuses: Sequence[Fieldbus]) -> list[BaseException]:
    """Stop every one, whatever becomes of the others; the errors, in their order."""
    ends = await asyncio.gather(*(each.stop() for each in fieldbuses), return_exceptions=True)
    return [end for end in ends if isinstance(end, BaseException)]


def _copy(source: NDArray[np.void], target: NDArray[np.void], rows: list[int]) -> None:
    if rows:
        target[rows] = source[rows]
