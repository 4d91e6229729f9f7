"""From a configuration to its fieldbus, and to what paces a run on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.drivers.canopen.sto_relay import RelayedFieldbus
from tonus.drivers.fieldbus import Fieldbus, FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.drivers.several import SeveralFieldbuses
from tonus.sim.lab.engine import Lab
from tonus.tools.fieldbus.kind import MakePacing
from tonus.tools.fieldbus.registry import fieldbus_kind


def channels(config: Config) -> list[str]:
    """The CAN channels of a configuration, in the order in which their frames are numbered."""
    return [name for bus in config.fieldbus.parts for name in bus.can_channels]


def build(
    config: Config, image: ProcessImage, lab: Lab | None = None, tap: FrameTap | None = None
) -> Fieldbus:
    """``lab`` is one in this process and this loop, whose buses are then used. Raises `ToolError`
    and `DriverError`."""
    fieldbus = _build(config, image, lab, tap)
    return fieldbus if config.relay is None else RelayedFieldbus(config, fieldbus)


def _build(config: Config, image: ProcessImage, lab: Lab | None, tap: FrameTap | None) -> Fieldbus:
    bus = config.fieldbus
    if bus.parts == (bus,):
        return fieldbus_kind(bus).build(config, image, lab, tap)
    names = channels(config)

    def part(theirs: Config, rows: ProcessImage) -> Fieldbus:
        first = channels(theirs)
        return _build(theirs, rows, lab, _numbered(tap, names.index(first[0]) if first else 0))

    return SeveralFieldbuses(config, image, part)


def _numbered(tap: FrameTap | None, first: int) -> FrameTap | None:
    """The same tap for a bus whose channels are not the first."""
    return tap if tap is None or not first else _Numbered(tap, first)


class _Numbered:
    def __init__(self, tap: FrameTap, first: int) -> None:
        self._tap, self._first = tap, first

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        self._tap.frame(stamp_ns, self._first + channel, identifier, data, sent=sent)

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None:
        self._tap.sent(frames, self._first + channel, now_ns)

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        self._tap.sent_together(frames, self._first + channel, now_ns)

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        self._tap.received(frames, self._first + channel, now_ns)


def steering(config: Config, fieldbus: Fieldbus, pacing: MakePacing) -> MakePacing:
    """``pacing``, steered where the configuration lets a bus' clocks lead; the first one's. Raises
    `ToolError`."""
    if isinstance(fieldbus, RelayedFieldbus):
        fieldbus = fieldbus.fieldbus
    found = [(config.fieldbus, fieldbus)]
    if isinstance(fieldbus, SeveralFieldbuses):
        found = fieldbus.parts
    for bus, each in found:
        pace = fieldbus_kind(bus).pace if bus.paces else None
        if pace is not None:
            return pace(each, pacing)
    return pacing


def pacing_name(config: Config, *, virtual: bool) -> str:
    """What paces a run, for its log."""
    timer = "virtual time" if virtual else "timer"
    leads = any(bus.paces for bus in config.fieldbus.parts)
    return f"distributed clock on {timer}" if leads else timer
