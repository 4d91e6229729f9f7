"""The registration of one kind of fieldbus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from tonus.config.schema.bus import FieldbusSection
from tonus.config.schema.realtime import HostLimits
from tonus.config.schema.root import Config
from tonus.drivers.fieldbus import Fieldbus, FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing.scheduler import Pacing
from tonus.sim.lab.emulation import Emulate
from tonus.sim.lab.engine import Lab
from tonus.tools.check.finding import Finding
from tonus.tools.doctor.finding import Finding as Examined

Build = Callable[[Config, ProcessImage, Lab | None, FrameTap | None], Fieldbus]
"""Makes the driver for ``config.fieldbus``, which has the kind's schema, on an image of
`config.robot.cables` rows. The lab is one in this process and this loop, whose side of the bus is
then used (`Lab.port`); the tap receives CAN frames, where there are any. Raises a `DriverError` or
a `ToolError`."""
MakePacing = Callable[[], Pacing]


def _nothing(*_: object) -> Iterable[Any]:
    return ()


@dataclass(frozen=True)
class FieldbusKind:
    """One kind of fieldbus: what Tonus asks of it, by the rooms that ask.

    An entry point of the group ``tonus.fieldbuses`` names an object of this class, or the
    configuration does: ``kind: package.module:OBJECT``.
    """

    schema: type[FieldbusSection]
    """the ``fieldbus:`` section: its keys, its nodes, its drives' profiles"""
    build: Build
    emulate: Emulate | None = None
    """the lab's side of the bus; None: it runs on hardware only"""
    check: Callable[[Config, Any], Iterable[Finding]] = _nothing
    """rows of `tonus check` for a section of this kind; nothing is started and nothing raises"""
    examine: Callable[[Config, Any, HostLimits], Iterable[Examined]] = _nothing
    """rows of `tonus doctor` for the host's side of it"""
    pace: Callable[[Fieldbus, MakePacing], MakePacing] | None = None
    """the loop's pacing where the clocks of the devices lead it (`FieldbusSection.paces`)"""
