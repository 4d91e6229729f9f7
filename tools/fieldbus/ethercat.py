"""EtherCAT: SOEM on an interface; a lab of this process answers our own master."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tonus.config.schema.bus import EthercatBus
from tonus.config.schema.root import Config
from tonus.drivers.ethercat.deterministic import DeterministicMaster
from tonus.drivers.ethercat.master import EthercatFieldbus
from tonus.drivers.ethercat.ring import injected_ring
from tonus.drivers.ethercat.soem import SoemMaster
from tonus.drivers.ethercat.wire import Wire
from tonus.drivers.fieldbus import Fieldbus, FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing.steering import SteeredPacing
from tonus.sim.ethercat.ring import Ring
from tonus.sim.lab.engine import Lab
from tonus.tools.check.ethercat import check_ethercat
from tonus.tools.check.finding import Finding
from tonus.tools.check.losses import check_interpolation, check_watchdog
from tonus.tools.check.mappings import check_mappings
from tonus.tools.fieldbus.kind import FieldbusKind, MakePacing


def _build(
    config: Config, image: ProcessImage, lab: Lab | None, tap: FrameTap | None
) -> EthercatFieldbus:
    del tap  # its frames are not CAN's
    return EthercatFieldbus(config, image, SoemMaster if lab is None else _wire(lab))


def _wire(lab: Lab) -> Callable[[EthercatBus, Callable[[], int]], Wire]:
    segments = lab.segments

    def deterministic(bus: EthercatBus, now_ns: Callable[[], int]) -> Wire:
        segment = segments[bus.interface]
        if bus.redundant_interface is None:
            return DeterministicMaster(bus, segment.exchange, now_ns)
        ring = Ring(segment)
        states = injected_ring(ring.through, now_ns)
        return DeterministicMaster(bus, ring.around, now_ns, states=states)

    return deterministic


def _check(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    yield from check_mappings(bus)
    yield from check_ethercat(config, bus)
    yield from check_interpolation(bus)
    yield from check_watchdog(config, bus)


def _pace(fieldbus: Fieldbus, pacing: MakePacing) -> MakePacing:
    assert isinstance(fieldbus, EthercatFieldbus)  # as built above
    return lambda: SteeredPacing(pacing(), fieldbus, fieldbus.clocks)


ETHERCAT = FieldbusKind(EthercatBus, _build, check=_check, pace=_pace)
