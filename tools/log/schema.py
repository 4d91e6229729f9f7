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
_FIELD = re.compile(r"^(\w+)(?:\[(\d+)\])?\s+(\w+)$")
_FRAME = "can_msgs/msg/Frame"


def body_dtype(message: str, definition: str, size: int) -> np.dtype[np.void] | None:
    """The dtype of a CDR body of ``size`` bytes, or None for a message that is not of one size:
    then it has to be decoded one by one."""
    if message == _FRAME:
        return _frame(size)
    members: list[tuple[str, str, int, int]] = []
    at = 0
    for line in definition.splitlines():
        text = line.split("#", 1)[0].strip()
        if not text or "=" in text:
            continue
        match = _FIELD.match(text)
        if match is None or match[1] not in _SCALARS:
            return None
        code = _SCALARS[match[1]]
        width = np.dtype(code).itemsize
        count = int(match[2] or 0)
        at += -at % width
        members.append((match[3], code, count, at))
        at += width * max(count, 1)
    # Encoders may pad the end of a body to four or eight bytes.
    if not members or not at <= size < at + 8:
        return None
    return _dtype(members, size)


def _frame(size: int) -> np.dtype[np.void] | None:
    """std_msgs/Header's frame_id is the only member of variable length, and one for each bus."""
    tail = 4 + 4 + 8
    if size < 16 + tail:
        return None
    at = size - tail
    names = ("is_rtr", "is_extended", "is_error", "dlc")
    members = [("sec", "<i4", 0, 0), ("nanosec", "<u4", 0, 4), ("id", "<u4", 0, at)]
    members += [
        (name, "u1" if name == "dlc" else "?", 0, at + 4 + index)
        for index, name in enumerate(names)
    ]
    members.append(("data", "u1", 8, at + 8))
    return _dtype(members, size)


def _dtype(members: list[tuple[str, str, int, int]], size: int) -> np.dtype[np.void]:
    formats = [(code, (count,)) if count else code for _, code, count, _ in members]
    return np.dtype(
        {
            "names": [name for name, _, _, _ in members],
            "formats": formats,
            "offsets": [at for _, _, _, at in members],
            "itemsize": size,
        }
    )
