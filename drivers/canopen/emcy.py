"""Emergency messages of CiA 301."""

from __future__ import annotations

import struct

_FRAME = struct.Struct("<HB")


def parse(data: bytes) -> tuple[int, int] | None:
    """(error code, error register 0x1001) of an EMCY frame; None if it is too short for both."""
    if len(data) < _FRAME.size:
        return None
    code, register = _FRAME.unpack_from(data)
    return code, register
