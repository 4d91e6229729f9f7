"""CANopen."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.root import Config
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.fieldbus import FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.sim.lab.engine import Lab
from tonus.tools.check.canopen import check_canopen
from tonus.tools.check.finding import Finding
from tonus.tools.check.losses import check_heartbeats, check_interpolation
from tonus.tools.check.mappings import check_mappings
from tonus.tools.check.supervisor import check_ramps, check_watches
from tonus.tools.doctor.socketcan import examine
from tonus.tools.fieldbus.kind import FieldbusKind


def _build(
    config: Config, image: ProcessImage, lab: Lab | None, tap: FrameTap | None
) -> CanopenFieldbus:
    del lab  # its channels are found by their names
    return CanopenFieldbus(config, image, tap)


def _check(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    yield from check_mappings(bus)
    yield from check_canopen(config, bus)
    yield from check_interpolation(bus)
    yield from check_heartbeats(config, bus)
    yield from check_watches(config, bus)
    yield from check_ramps(config, bus)


CANOPEN = FieldbusKind(CanopenBus, _build, check=_check, examine=examine)
