"""The SDO information service: a slave tells what objects it has (ETG.1000.6, 5.6.3)."""

from __future__ import annotations

import struct

from tonus.sim.devices.objects import AbortError, Entry, Kind, ObjectDictionary

_SERVICE = 8
_LIST, _OBJECT, _ENTRY, _ERROR = 1, 3, 5, 7
_HEADER = struct.Struct("<HBBH")
_DATA_TYPES = {
    Kind.I8: 0x0002,
    Kind.I16: 0x0003,
    Kind.I32: 0x0004,
    Kind.U8: 0x0005,
    Kind.U16: 0x0006,
    Kind.U32: 0x0007,
    Kind.REAL32: 0x0008,
    Kind.REAL64: 0x0011,
    Kind.I64: 0x0015,
    Kind.STRING: 0x0009,
    Kind.U64: 0x001B,
}
_VARIABLE, _ARRAY, _RECORD = 7, 8, 9
_UNSIGNED8 = 0x0005
_READ_ALL, _WRITE_ALL = 0x07, 0x38
_INTO_RECEIVE, _INTO_TRANSMIT = 0x40, 0x80
_NO_COMMAND = 0x05040001
_MORE = 0x80


def serve(objects: ObjectDictionary, message: bytes, room: int) -> list[bytes]:
    """Answers to a message of the service; ``room``: bytes of content a mailbox holds."""
    message = message.ljust(12, b"\0")
    _, opcode, _, _ = _HEADER.unpack_from(message)
    try:
        if opcode & 0x7F == _LIST:
            return _fragments(_LIST, _list(objects, struct.unpack_from("<H", message, 6)[0]), room)
        if opcode & 0x7F == _OBJECT:
            index = struct.unpack_from("<H", message, 6)[0]
            return _fragments(_OBJECT, _object(objects, index), room)
        if opcode & 0x7F == _ENTRY:
            index, subindex, values = struct.unpack_from("<HBB", message, 6)
            return _fragments(_ENTRY, _entry(objects, index, subindex, values), room)
        raise AbortError(_NO_COMMAND)
    except AbortError as abort:
        return [_HEADER.pack(_SERVICE << 12, _ERROR, 0, 0) + struct.pack("<I", abort.code)]


def _fragments(request: int, data: bytes, room: int) -> list[bytes]:
    """The answer, in as many messages as it takes; the first bytes are told once only."""
    step = room - _HEADER.size
    parts = [data[at : at + step] for at in range(0, len(data), step)]
    found = []
    for number, part in enumerate(parts):
        left = len(parts) - number - 1
        opcode = request + 1 | (_MORE if left else 0)
        found.append(_HEADER.pack(_SERVICE << 12, opcode, 0, left) + part)
    return found


def _list(objects: ObjectDictionary, kind: int) -> bytes:
    """Kind 0: how many objects each list has; 1 all; 2, 3 what an RPDO or TPDO may carry; 4, 5
    what is stored."""
    lists = [_indices(objects, number) for number in range(1, 6)]
    if kind == 0:
        return struct.pack("<H5H", 0, *map(len, lists))
    found = lists[kind - 1] if kind <= len(lists) else []
    return struct.pack(f"<H{len(found)}H", kind, *found)


def _indices(objects: ObjectDictionary, kind: int) -> list[int]:
    def wanted(entry: Entry) -> bool:
        if kind in (2, 3):
            return ("r" if kind == 2 else "t") in entry.mapping
        return kind == 1 or (entry.access == "rw" and entry.lasting)

    return sorted({index for (index, _), entry in objects.entries.items() if wanted(entry)})


def _name(objects: ObjectDictionary, index: int) -> str:
    return objects.names.get(index) or objects.find(index, 0).name


def _object(objects: ObjectDictionary, index: int) -> bytes:
    head = objects.find(index, 0)
    parts = sorted(sub for found, sub in objects.entries if found == index and sub)
    if not parts:
        code, kind, highest = _VARIABLE, _DATA_TYPES[head.kind], 0
    else:
        kinds = {objects.find(index, sub).kind for sub in parts}
        code = _ARRAY if len(kinds) == 1 else _RECORD
        kind = _DATA_TYPES[objects.find(index, parts[0]).kind]
        highest = parts[-1]
    return struct.pack("<HHBB", index, kind, highest, code) + _name(objects, index).encode("ascii")


def _entry(objects: ObjectDictionary, index: int, subindex: int, values: int) -> bytes:
    entry = objects.find(index, subindex)
    access = 0
    if entry.access != "wo":
        access |= _READ_ALL
    if entry.access in ("rw", "wo"):
        access |= _WRITE_ALL
    if "r" in entry.mapping:
        access |= _INTO_RECEIVE
    if "t" in entry.mapping:
        access |= _INTO_TRANSMIT
    size = len(entry.encode()) if entry.kind is Kind.STRING else entry.kind.size
    head = struct.pack(
        "<HBBHHH", index, subindex, values, _DATA_TYPES[entry.kind], 8 * size, access
    )
    return head + entry.name.encode("ascii")
