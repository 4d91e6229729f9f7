"""Whether the PDOs of drives and cells carry what control needs."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.schema.bus import Amplifier, FieldbusSection, ForceCell
from tonus.config.schema.drive import DriveProfile
from tonus.drivers.canopen.process_data import drive_encoder
from tonus.drivers.cia301.pdo import Mapping, PdoError
from tonus.drivers.devices import drive, force_cell
from tonus.tools.check.finding import Finding


def check_mappings(bus: FieldbusSection) -> Iterator[Finding]:
    """One outcome for each PDO of each profile, and for the cells'; nothing raises."""
    for key, profile in bus.every_profile.items():
        yield from _drive_mappings(key, profile)
    yield _cell_mapping(bus.force_cell)


def _drive_mappings(key: str, profile: DriveProfile) -> Iterator[Finding]:
    needed = "statusword 0x60410010, position 0x60640020 and torque 0x60770010"
    commands = "controlword 0x60400010 and target torque 0x60710010"
    try:
        drive_encoder(Mapping.of(profile.rpdo))
        problem = ""
    except PdoError as error:
        problem = str(error)
    yield Finding(
        "PDO mapping",
        not problem,
        f"{key}.rpdo",
        problem or f"maps {commands}",
        f"map {commands}",
    )
    try:
        mapping = Mapping.of(profile.tpdo)
        for entry in (drive.STATUSWORD, drive.POSITION_ACTUAL, drive.TORQUE_ACTUAL):
            mapping.position(entry)
        problem = ""
    except PdoError as error:
        problem = str(error)
    yield Finding(
        "PDO mapping",
        not problem,
        f"{key}.tpdo",
        problem or f"maps {needed}",
        f"map {needed}",
    )


def _cell_mapping(cell: ForceCell | Amplifier) -> Finding:
    values = ", ".join(f"0x{entry:08X}" for entry in force_cell.PROCESS_VALUES)
    try:
        found = set(Mapping.of(cell.tpdo).entries) & set(force_cell.PROCESS_VALUES)
        problem = "" if found else "the PDO maps no process value of channel 1"
    except PdoError as error:
        problem = str(error)
    return Finding(
        "PDO mapping",
        not problem,
        "fieldbus.force_cell.tpdo",
        problem or "maps the process value",
        f"map one of {values}",
    )
