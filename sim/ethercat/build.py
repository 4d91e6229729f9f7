"""A configuration's EtherCAT segment, with the lab's devices behind its slaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from tonus.config.schema.bus import EthercatBus
from tonus.config.schema.lab import Lab as LabConfig
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.device import Device
from tonus.sim.devices.eds.drive import EdsDrive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.timers import Timers
from tonus.sim.errors import LabError
from tonus.sim.ethercat.segment import Lab, Segment
from tonus.sim.ethercat.slaves.identity import EPOS4, Kind, amplifier
from tonus.sim.ethercat.slaves.identity import drive as drive_kind
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.plant.streams import Stream, generator

_PPM = 1e-6
_ORIGINS_NS = 10_000_000_000
"""Clocks show anything up to this at switch-on."""


class _TimedLab(Lab, Timers, Protocol):
    """What a segment and its slaves need of a lab."""


def build_segment(
    lab: _TimedLab,
    bus: EthercatBus,
    config: LabConfig,
    drives: Sequence[Cia402Drive],
    cells: Mapping[tuple[int, ...], ForceCell],
    seed: int,
) -> Segment:
    """Raises `LabError` without a lab's end of the segment."""
    end = config.ethercat
    if end is None:
        raise LabError(
            "lab.ethercat is missing: it names the interface the slaves answer on; "
            "see config/lab.yaml"
        )
    draws = generator(seed, Stream.SEGMENT)
    ring = bus.redundant_interface is not None
    segment = Segment(bus.interface, lab, hop_ns=end.hop_ns, ring=ring)
    segment.disturbance.draws = draws.spawn(1)[0]
    spread = end.clock_spread_ppm * _PPM
    for slave in bus.slaves:
        device: Device
        if slave.axis is not None:
            device = drives[slave.axis]
            kind = _kind(device)
        else:
            device, kind = cells[slave.cells], amplifier(len(slave.cells))
        drift = float(draws.uniform(-spread, spread))
        origin = int(draws.integers(_ORIGINS_NS))
        _attach(segment, device, kind, lab, drift, origin)
    return segment


def _kind(drive: Cia402Drive) -> Kind:
    if not isinstance(drive, EdsDrive):
        return EPOS4
    vendor, product, revision = (drive.objects.number(0x1018, place) for place in (1, 2, 3))
    name = drive.sheet.product_name.encode("ascii", "replace").decode("ascii")
    return drive_kind(name, vendor, product, revision, drive.longest_mapping)


def _attach(
    segment: Segment, device: Device, kind: Kind, timers: Timers, drift: float, origin: int
) -> None:
    segment.attach(
        lambda number: Slave(device, kind, number, segment, timers, drift=drift, origin=origin)
    )
