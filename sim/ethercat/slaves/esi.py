"""The EtherCAT slave information (ESI) of the emulated slaves: XML for other masters, ETG.2000.

Made from the same dictionary the slave answers with, so that the two cannot differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.devices.objects import Entry, ObjectDictionary
from tonus.sim.devices.objects import Kind as DataKind
from tonus.sim.errors import LabError
from tonus.sim.ethercat.slaves.process_data import RECEIVE_MAPPING, TRANSMIT_MAPPING
from tonus.sim.ethercat.slaves.sii import managers
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.lab.engine import Lab

_TYPES = {
    DataKind.U8: "USINT",
    DataKind.U16: "UINT",
    DataKind.U32: "UDINT",
    DataKind.U64: "ULINT",
    DataKind.I8: "SINT",
    DataKind.I16: "INT",
    DataKind.I32: "DINT",
    DataKind.I64: "LINT",
    DataKind.REAL32: "REAL",
    DataKind.REAL64: "LREAL",
}
_MANAGER_NAMES = ("MBoxOut", "MBoxIn", "Outputs", "Inputs")
_VENDORS = {0x000000FB: "maxon motor ag", 0x0000FFFF: "Tonus lab"}
_SYNC0 = 0x0300


def files(config: Config) -> dict[str, str]:
    """File name to text, one for each kind of slave. Raises `LabError` without a segment."""
    if config.lab is None:
        raise LabError(f"configuration {config.name} has no lab section")
    lab = Lab(config, LabScript(), seed=0, clock=lambda: 0)
    if not lab.segments:
        raise LabError(f"configuration {config.name} has no EtherCAT segment")
    found: dict[str, str] = {}
    for segment in lab.segments.values():
        for slave in segment.slaves:
            name = slave.kind.name.lower().replace(",", "").replace(" ", "_")
            found.setdefault(f"{name}.xml", esi(slave))
    return found


def _hex(value: int, digits: int = 4) -> str:
    return f"#x{value:0{digits}X}"


def _add(parent: ET.Element, tag: str, text: str | int = "", **attributes: str) -> ET.Element:
    made = ET.SubElement(parent, tag, attributes)
    if text != "":
        made.text = str(text)
    return made


def esi(slave: Slave) -> str:
    """The whole file of one kind of slave."""
    kind, objects = slave.kind, slave.device.objects
    root = ET.Element("EtherCATInfo", Version="1.6")
    vendor = _add(root, "Vendor")
    _add(vendor, "Id", _hex(kind.vendor, 8))
    _add(vendor, "Name", _VENDORS.get(kind.vendor, "unknown"))
    descriptions = _add(root, "Descriptions")
    group = _add(_add(descriptions, "Groups"), "Group")
    _add(group, "Type", kind.group)
    _add(group, "Name", kind.group)
    device = _add(_add(descriptions, "Devices"), "Device", Physics="YY")
    product, revision = _hex(kind.product, 8), _hex(kind.revision, 8)
    _add(device, "Type", kind.name, ProductCode=product, RevisionNo=revision)
    _add(device, "Name", kind.name)
    _add(device, "GroupType", kind.group)
    _add_profile(device, objects)
    for way in ("Outputs", "Inputs", "MBoxState") if kind.outputs else ("Inputs", "MBoxState"):
        _add(device, "Fmmu", way)
    outputs, inputs = slave.process_data.sizes()
    sizes = (kind.mailbox_bytes, kind.mailbox_bytes, outputs, inputs)
    for label, size, (start, _, control, use) in zip(
        _MANAGER_NAMES, sizes, managers(kind), strict=True
    ):
        if not use:
            _add(device, "Sm", StartAddress=_hex(0), ControlByte=_hex(0, 2), Enable="0")
            continue
        given = {"DefaultSize": str(size), "StartAddress": _hex(start), "Enable": "1"}
        if use <= 2:
            given["MinSize"] = given["MaxSize"] = str(size)
        _add(device, "Sm", label, ControlByte=_hex(control, 2), **given)
    for tag, base, count, manager in (
        ("RxPdo", RECEIVE_MAPPING, len(slave.device.receive_pdos), 2),
        ("TxPdo", TRANSMIT_MAPPING, len(slave.device.transmit_pdos), 3),
    ):
        for number in range(count):
            others = [base + other for other in range(count) if other != number]
            _add_pdo(device, tag, objects, base + number, others, manager if not number else None)
    mailbox = _add(device, "Mailbox", DataLinkLayer="1")
    _add(
        mailbox,
        "CoE",
        SdoInfo="1",
        PdoAssign="1",
        PdoConfig="1",
        CompleteAccess=str(int(kind.complete_access)),
        SegmentedSdo="1",
    )
    mode = _add(_add(device, "Dc"), "OpMode")
    _add(mode, "Name", "DC")
    _add(mode, "Desc", "Synchronous with SYNC0")
    _add(mode, "AssignActivate", _hex(_SYNC0))
    eeprom = _add(device, "Eeprom")
    image = slave.controller.eeprom.image
    _add(eeprom, "ByteSize", len(image))
    _add(eeprom, "ConfigData", bytes(image[:14]).hex().upper())
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _add_profile(device: ET.Element, objects: ObjectDictionary) -> None:
    profile = _add(device, "Profile")
    _add(profile, "ProfileNo", objects.number(0x1000, 0) & 0xFFFF)
    dictionary = _add(profile, "Dictionary")
    types = _add(dictionary, "DataTypes")
    listed = _add(dictionary, "Objects")
    for name, bits in _base_types(objects):
        one = _add(types, "DataType")
        _add(one, "Name", name)
        _add(one, "BitSize", bits)
    for index in sorted({index for index, _ in objects.entries}):
        parts = sorted(sub for found, sub in objects.entries if found == index)
        one = _add(listed, "Object")
        _add(one, "Index", _hex(index))
        if parts == [0]:
            entry = objects.find(index, 0)
            _add(one, "Name", entry.name)
            _add(one, "Type", _type(entry))
            _add(one, "BitSize", _bits(entry))
            _add_flags(one, entry)
        else:
            _add(one, "Name", objects.names.get(index, objects.find(index, parts[-1]).name))
            _add(one, "Type", f"DT{index:04X}")
            _add(one, "BitSize", _add_record(types, objects, index, parts))
            _add(_add(one, "Flags"), "Access", "ro")


def _add_record(
    types: ET.Element, objects: ObjectDictionary, index: int, parts: Sequence[int]
) -> int:
    """The data type of an object with parts; its bits. Subindex 0 takes 16."""
    one = _add(types, "DataType")
    _add(one, "Name", f"DT{index:04X}")
    total = _add(one, "BitSize")
    at = 0
    for sub in parts:
        entry = objects.find(index, sub)
        item = _add(one, "SubItem")
        _add(item, "SubIdx", sub)
        _add(item, "Name", entry.name)
        _add(item, "Type", _type(entry))
        _add(item, "BitSize", _bits(entry))
        _add(item, "BitOffs", at)
        _add_flags(item, entry)
        at += 16 if sub == 0 else _bits(entry)
    total.text = str(at)
    return at


def _base_types(objects: ObjectDictionary) -> list[tuple[str, int]]:
    return sorted({(_type(entry), _bits(entry)) for entry in objects.entries.values()})


def _type(entry: Entry) -> str:
    if entry.kind is DataKind.STRING:
        return f"STRING({len(entry.encode())})"
    return _TYPES[entry.kind]


def _bits(entry: Entry) -> int:
    return 8 * (len(entry.encode()) if entry.kind is DataKind.STRING else entry.kind.size)


def _add_flags(parent: ET.Element, entry: Entry) -> None:
    flags = _add(parent, "Flags")
    _add(flags, "Access", "ro" if entry.access == "const" else entry.access)
    if entry.mapping:
        _add(flags, "PdoMapping", entry.mapping.replace("rt", "tr").upper())


def _add_pdo(
    device: ET.Element,
    tag: str,
    objects: ObjectDictionary,
    index: int,
    others: Sequence[int],
    manager: int | None,
) -> None:
    """One PDO with its default mapping; only one of them can be assigned at a time."""
    pdo = _add(device, tag, Fixed="0", **({} if manager is None else {"Sm": str(manager)}))
    _add(pdo, "Index", _hex(index))
    _add(pdo, "Name", objects.names[index])
    for other in others:
        _add(pdo, "Exclude", _hex(other))
    for place in range(1, objects.number(index, 0) + 1):
        word = objects.number(index, place)
        entry = objects.find(word >> 16, word >> 8 & 0xFF)
        one = _add(pdo, "Entry")
        _add(one, "Index", _hex(word >> 16))
        _add(one, "SubIndex", word >> 8 & 0xFF)
        _add(one, "BitLen", word & 0xFF)
        _add(one, "Name", entry.name)
        _add(one, "DataType", _type(entry))
