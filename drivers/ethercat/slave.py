"""One slave of the segment: what it must be and hold, and its process data against the exchange."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.config.schema.bus import EthercatBus
from tonus.config.schema.drive import DriveProfile, Identity
from tonus.config.schema.robot import Robot
from tonus.drivers.canopen.process_data import Encode, drive_encoder
from tonus.drivers.cia301.pdo import Mapping
from tonus.drivers.cia301.setting import ObjectAccess, Setting, apply
from tonus.drivers.devices import drive, force_cell
from tonus.drivers.errors import DriverError
from tonus.drivers.ethercat.al import AlState
from tonus.drivers.ethercat.wire import Found, Sizes
from tonus.drivers.exchange import Exchange

RX_ASSIGNMENT, TX_ASSIGNMENT = 0x1C12, 0x1C13
_RX_MAPPING, _TX_MAPPING = 0x1600, 0x1A00


class SlaveError(DriverError):
    """A slave is not the device it should be, or holds something else than it was told."""


@dataclass(frozen=True)
class Slave:
    """Its place on the cable, from 0, its rows in the process image, and its process data."""

    number: int
    where: str
    """for people, counted from 1: tonus0/3"""
    title: str
    identity: Identity | None
    settings: tuple[Setting, ...]
    rx: tuple[int, ...]
    """mapping words of its outputs"""
    tx: tuple[int, ...]
    sizes: Sizes
    axis: int | None = None
    cells: tuple[int, ...] = ()
    profile: DriveProfile | None = None
    """of a drive"""

    def counts(self, state: int) -> int:
        """What it adds to the working counter in this state: 1 for inputs delivered, from SAFEOP
        on, and 2 for outputs taken, in OP."""
        delivers = bool(self.tx) and state in (AlState.SAFEOP, AlState.OP)
        return delivers + 2 * (bool(self.rx) and state == AlState.OP)

    def identify(self, found: Found) -> str:
        """What is wrong with the device that was found; "" for nothing."""
        wanted = self.identity
        if wanted is None:
            return ""
        for name, value in (("vendor", wanted.vendor), ("product", wanted.product)):
            there = getattr(found, name)
            if there != value:
                return f"is another device: {name} 0x{there:08X}, not 0x{value:08X}"
        if found.revision < wanted.minimum_revision:
            return (
                f"firmware too old: revision 0x{found.revision:08X}, "
                f"at least 0x{wanted.minimum_revision:08X} is needed"
            )
        return ""

    async def configure(self, access: ObjectAccess, exchange: Exchange) -> None:
        """Settings, then PDO mapping and assignment, all read back; ``exchange`` is told a drive's
        scale. Raises `DriverError`."""
        await apply(access, self.settings)
        if self.axis is not None and self.profile is not None:
            await exchange.read_scale(self.axis, access, self.profile)
        if self.rx:
            await _assign(access, RX_ASSIGNMENT, _RX_MAPPING, self.rx)
        await _assign(access, TX_ASSIGNMENT, _TX_MAPPING, self.tx)


def slaves(bus: EthercatBus, robot: Robot) -> list[Slave]:
    """The segment as it is configured. Raises `DriverError` for a mapping that control cannot work
    with, and for a setting that its object cannot hold."""
    built = []
    trains = robot.drive_trains
    for number, each in enumerate(bus.slaves):
        where = f"{bus.interface}/{number + 1}"
        identity, profile = bus.identity(each), None
        if each.axis is not None:
            profile = bus.profile(each.axis)
            rx, tx = profile.rpdo, profile.tpdo
            title = f"drive of axis {each.axis}"
            settings = drive.settings(trains[each.axis], profile)
        else:
            rx, tx = (), bus.force_cell.mapping(len(each.cells))
            title = f"amplifier of cell {' '.join(map(str, each.cells))}"
            settings = force_cell.settings(bus.force_cell, len(each.cells))
        sizes = Sizes(Mapping.of(rx).layout.size, Mapping.of(tx).layout.size)
        built.append(
            Slave(
                number,
                where,
                title,
                identity,
                settings,
                rx,
                tx,
                sizes,
                each.axis,
                each.cells,
                profile,
            )
        )
    return built


async def _assign(
    access: ObjectAccess, assignment: int, mapping: int, entries: tuple[int, ...]
) -> None:
    """Map ``entries`` into the first PDO and make it the only one. CiA 301's order: the counts
    are 0 while what they count is changed."""
    await access.write(assignment, 0, b"\0")
    await access.write(mapping, 0, b"\0")
    for subindex, entry in enumerate(entries, start=1):
        await access.write(mapping, subindex, entry.to_bytes(4, "little"))
    await access.write(mapping, 0, bytes((len(entries),)))
    await access.write(assignment, 1, mapping.to_bytes(2, "little"))
    await access.write(assignment, 0, b"\1")
    wanted = [(mapping, 0, len(entries)), (assignment, 0, 1), (assignment, 1, mapping)]
    wanted += [(mapping, subindex, entry) for subindex, entry in enumerate(entries, start=1)]
    for index, subindex, value in wanted:
        found = int.from_bytes(await access.read(index, subindex), "little")
        if found != value:
            raise SlaveError(
                f"0x{index:04X}:{subindex} reads 0x{found:X}, not 0x{value:X} as written"
            )


def encoder(slave: Slave) -> Encode:
    """Raises `PdoError`."""
    return drive_encoder(Mapping.of(slave.rx))
