"""From a ROS 2 message definition to the numpy dtype of its CDR body."""

from __future__ import annotations

import re

import numpy as np

_SCALARS = {
    "float64": "<f8",
    "float32": "<f4",
    "int64": "<i8",
    "uint64": "<u8",
    "int32": "<i4",
    "uint32": "<u4",
    "int16": "<i2",
    "uint16": "<u2",
    "int8": "i1",
    "uint8": "u1",
    "byte": "u1",
    "char": "u1",
    "bool": "?",
}
_FIELD = re.compile(r"^(\w+)(?:\[(\d{1,9})\])?\s+(\w+)$")
_FRAME = "can_msgs/msg/Frame"
_FRAME_TAIL = 4 + 4 + 8
"""identifier, four flags, data"""
_SMALLEST_FRAME = 16 + _FRAME_TAIL
_LARGEST = 1 << 20
Member = tuple[str, str, int, int]
"""name, code, length of an array or 0, offset"""


def body_dtype(message: str, definition: str, size: int) -> np.dtype[np.void] | None:
    """The dtype of a CDR body of ``size`` bytes, or None for a message that is not of one size:
    then it has to be decoded one by one."""
    if message == _FRAME:
        return _frame(size)
    members, end = _members(definition)
    # Encoders may pad the end of a body to four or eight bytes.
    if not members or not end <= size < end + 8:
        return None
    return _dtype(members, size)


def smallest_dtype(message: str, definition: str) -> np.dtype[np.void] | None:
    """The same for a topic without messages, whose size is not known."""
    if message == _FRAME:
        return _frame(_SMALLEST_FRAME)
    members, end = _members(definition)
    return _dtype(members, end) if 0 < end <= _LARGEST else None


def _members(definition: str) -> tuple[list[Member], int]:
    """Members of a flat message of fixed size and where they end; none if it is not such a one."""
    members: list[Member] = []
    names: set[str] = set()
    at = 0
    for line in definition.splitlines():
        text = line.split("#", 1)[0].strip()
        if not text or "=" in text:
            continue
        match = _FIELD.match(text)
        if match is None or match[1] not in _SCALARS or match[3] in names:
            return [], 0
        names.add(match[3])
        code = _SCALARS[match[1]]
        width = np.dtype(code).itemsize
        count = int(match[2] or 0)
        at += -at % width
        members.append((match[3], code, count, at))
        at += width * max(count, 1)
    return members, at


def _frame(size: int) -> np.dtype[np.void] | None:
    """std_msgs/Header's frame_id is the only member of variable length, and one for each bus."""
    if size < _SMALLEST_FRAME:
        return None
    at = size - _FRAME_TAIL
    names = ("is_rtr", "is_extended", "is_error", "dlc")
    members = [("sec", "<i4", 0, 0), ("nanosec", "<u4", 0, 4), ("id", "<u4", 0, at)]
    members += [
        (name, "u1" if name == "dlc" else "?", 0, at + 4 + index)
        for index, name in enumerate(names)
    ]
    members.append(("data", "u1", 8, at + 8))
    return _dtype(members, size)


def _dtype(members: list[Member], size: int) -> np.dtype[np.void]:
    formats = [(code, (count,)) if count else code for _, code, count, _ in members]
    return np.dtype(
        {
            "names": [name for name, _, _, _ in members],
            "formats": formats,
            "offsets": [at for _, _, _, at in members],
            "itemsize": size,
        }
    )
