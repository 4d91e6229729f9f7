"""A node's object dictionary as an electronic data sheet (CiA 306), which CANopen tools read.

Measured values have no default in it, nor have serial numbers. Nothing in it depends on the node's
number, which is `$NODEID`, or on when it was made.
"""

from __future__ import annotations

from collections.abc import Iterator

from tonus.sim.can.canopen.node import Node
from tonus.sim.devices.objects import Entry, Kind, ObjectDictionary, Value

_VARIABLE, _RECORD = 0x7, 0x9
_TYPES = {
    Kind.I8: 0x2,
    Kind.I16: 0x3,
    Kind.I32: 0x4,
    Kind.U8: 0x5,
    Kind.U16: 0x6,
    Kind.U32: 0x7,
    Kind.REAL32: 0x8,
    Kind.STRING: 0x9,
    Kind.REAL64: 0x11,
    Kind.I64: 0x15,
    Kind.U64: 0x1B,
}
_MANDATORY = (0x1000, 0x1001, 0x1018)
_MANUFACTURER = range(0x2000, 0x6000)
_BAUD_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)
_SERIAL = ((0x1018, 4), (0x2100, 1))
_VENDORS = {0xFB: "maxon motor", 0xFFFF: "Tonus"}
_DATE, _TIME = "01-01-2026", "12:00AM"


def eds(
    node: Node, file_name: str = "device.eds", baud_rates: tuple[int, ...] = _BAUD_RATES
) -> str:
    """``baud_rates`` (kbit/s) are those that the device can have."""
    device, objects = node.device, node.device.objects
    number = objects.number
    vendor = number(0x1018, 1)
    name = objects.find(0x1008, 0).value if (0x1008, 0) in objects.entries else "drive"
    lines = [
        *_section(
            "FileInfo",
            FileName=file_name,
            FileVersion=1,
            FileRevision=1,
            EDSVersion="4.0",
            Description=f"Emulated {name}",
            CreationTime=_TIME,
            CreationDate=_DATE,
            CreatedBy="Tonus",
            ModificationTime=_TIME,
            ModificationDate=_DATE,
            ModifiedBy="Tonus",
        ),
        *_section(
            "DeviceInfo",
            VendorName=_VENDORS.get(vendor, "unknown"),
            VendorNumber=f"0x{vendor:08X}",
            ProductName=name,
            ProductNumber=f"0x{number(0x1018, 2):08X}",
            RevisionNumber=f"0x{number(0x1018, 3):08X}",
            OrderCode=name,
            **{f"BaudRate_{rate}": int(rate in baud_rates) for rate in _BAUD_RATES},
            SimpleBootUpMaster=0,
            SimpleBootUpSlave=1,
            Granularity=8,
            DynamicChannelsSupported=0,
            GroupMessaging=0,
            NrOfRXPDO=len(device.receive_pdos),
            NrOfTXPDO=len(device.transmit_pdos),
            LSS_Supported=0,
        ),
        *_section("DummyUsage", **{f"Dummy{kind:04d}": 0 for kind in range(1, 8)}),
    ]
    indices = sorted({index for index, _ in objects.entries})
    own = [index for index in indices if index in _MANUFACTURER]
    rest = [index for index in indices if index not in own and index not in _MANDATORY]
    for title, part in (
        ("MandatoryObjects", [index for index in indices if index in _MANDATORY]),
        ("OptionalObjects", rest),
        ("ManufacturerObjects", own),
    ):
        listed = {str(place): f"0x{index:04X}" for place, index in enumerate(part, start=1)}
        lines += _section(title, SupportedObjects=len(part), **listed)
        for index in part:
            lines += _object(objects, index, node.node_id)
    return "\n".join(lines)


def _section(title: str, **pairs: Value) -> Iterator[str]:
    yield f"[{title}]"
    for key, value in pairs.items():
        yield f"{key}={value}"
    yield ""


def _object(objects: ObjectDictionary, index: int, node_id: int) -> Iterator[str]:
    subs = sorted(sub for other, sub in objects.entries if other == index)
    if subs == [0]:
        yield from _variable(f"{index:04X}", objects.find(index, 0), index, 0, node_id)
        return
    name = objects.names[index]
    yield from _section(
        f"{index:04X}", ParameterName=name, ObjectType=f"0x{_RECORD:X}", SubNumber=len(subs)
    )
    for sub in subs:
        yield from _variable(
            f"{index:04X}sub{sub:X}", objects.find(index, sub), index, sub, node_id
        )


def _variable(title: str, entry: Entry, index: int, sub: int, node_id: int) -> Iterator[str]:
    access = entry.access
    if access == "rw" and "r" in entry.mapping:
        access = "rww"
    pairs: dict[str, Value] = {
        "ParameterName": entry.name,
        "ObjectType": f"0x{_VARIABLE:X}",
        "DataType": f"0x{_TYPES[entry.kind]:04X}",
        "AccessType": access,
    }
    measured = entry.access == "ro" and entry.read is not None
    if not measured and (index, sub) not in _SERIAL and entry.access != "wo":
        pairs["DefaultValue"] = _number(entry.default, entry, node_id)
    pairs["PDOMapping"] = int(bool(entry.mapping))
    if entry.kind is not Kind.STRING and entry.access in ("rw", "wo"):
        least, most = entry.kind.limits
        low, high = (entry.low, entry.high)
        if entry.allowed:
            low, high = min(entry.allowed), max(entry.allowed)
        if (low, high) != (least, most):
            pairs["LowLimit"], pairs["HighLimit"] = _plain(low), _plain(high)
    yield from _section(title, **pairs)


def _plain(value: Value) -> Value:
    """A whole number without a point."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _number(value: Value, entry: Entry, node_id: int) -> Value:
    if entry.relative:
        assert isinstance(value, int)
        return f"$NODEID+0x{value - node_id:X}"
    if entry.kind is Kind.U32:
        return f"0x{value:08X}"
    return value
