"""The fieldbus without frames."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.schema.bus import DirectBus
from tonus.config.schema.root import Config
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.fieldbus import FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.tools.check.finding import Finding
from tonus.tools.check.mappings import check_mappings
from tonus.tools.errors import ToolError
from tonus.tools.fieldbus.kind import FieldbusKind


def _build(
    config: Config, image: ProcessImage, lab: Lab | None, tap: FrameTap | None
) -> DirectFieldbus:
    del tap  # there are no frames
    if lab is None:
        raise ToolError(
            "the direct fieldbus needs virtual time and a lab: add --virtual and a lab: section"
        )
    return DirectFieldbus(config, image, lab.direct, clock.loop_clock())


def _check(config: Config, bus: DirectBus) -> Iterator[Finding]:
    del config
    yield from check_mappings(bus)


DIRECT = FieldbusKind(DirectBus, _build, check=_check)
