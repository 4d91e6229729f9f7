"""A reader of .mat files of version 5 that shares nothing with the writer.

After "MAT-File Format", MathWorks (mathworks.com/help/pdf_doc/matlab/matfile_format.pdf):
what is needed for structs of numbers, of characters and of cells, in a file that is not compressed.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

_HEADER = 128
_MATRIX, _UTF8 = 14, 16
_SMALL = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4"}
_TYPES = {**_SMALL, 9: "<f8", 12: "<i8", 13: "<u8", _UTF8: "u1"}
_CELL, _STRUCT, _CHAR = 1, 2, 4
CLASSES = dict(zip((1, 2, 4, 6, 7), ("cell", "struct", "char", "double", "single"), strict=True))
CLASSES |= {8: "int8", 9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32"}
CLASSES |= {14: "int64", 15: "uint64"}


class Array:
    """One array: its class in MATLAB's words, and numbers, characters, cells or fields by name."""

    def __init__(self, kind: str, shape: tuple[int, ...], value: Any) -> None:
        self.kind, self.shape, self.value = kind, shape, value

    def __getitem__(self, name: str) -> Array:
        found: Array = self.value[name]
        return found

    @property
    def text(self) -> str:
        """Of a row of characters."""
        return "".join(self.value.ravel().tolist())


def read(path: Path) -> dict[str, Array]:
    """Every variable of a file."""
    data = path.read_bytes()
    version, endian = struct.unpack_from("<H2s", data, _HEADER - 4)
    assert (version, endian) == (0x0100, b"IM")
    at, found = _HEADER, {}
    while at < len(data):
        kind, body, at = _element(data, at)
        assert kind == _MATRIX
        name, array = _matrix(body)
        assert name not in found
        found[name] = array
    return found


def _element(data: bytes, at: int) -> tuple[int, bytes, int]:
    """Type, content, and where the next one begins."""
    first, size = struct.unpack_from("<II", data, at)
    if first >> 16:  # a small one: its size stands beside its type
        return first & 0xFFFF, data[at + 4 : at + 4 + (first >> 16)], at + 8
    body = data[at + 8 : at + 8 + size]
    assert len(body) == size
    return first, body, at + 8 + size + -size % 8


def _matrix(body: bytes) -> tuple[str, Array]:
    _, flags, at = _element(body, 0)
    _, dimensions, at = _element(body, at)
    _, name, at = _element(body, at)
    number = flags[0]
    shape = tuple(np.frombuffer(dimensions, "<i4").tolist())
    value: Any
    if number == _STRUCT:
        assert shape == (1, 1)
        _, length, at = _element(body, at)
        _, names, at = _element(body, at)
        width = struct.unpack("<i", length)[0]
        value = {}
        for start in range(0, len(names), width):
            _, inner, at = _element(body, at)
            field = names[start : start + width].split(b"\0")[0].decode("ascii")
            assert field not in value
            value[field] = _matrix(inner)[1]
    elif number == _CELL:
        value = []
        for _ in range(int(np.prod(shape))):
            _, inner, at = _element(body, at)
            value.append(_matrix(inner)[1])
    else:
        kind, content, at = _element(body, at)
        if number == _CHAR:
            letters = content.decode("utf-8") if kind == _UTF8 else content.decode("utf-16-le")
            value = np.array(list(letters), "U1").reshape(shape, order="F")
        else:
            value = np.frombuffer(content, _TYPES[kind]).reshape(shape, order="F")
    return name.decode("ascii"), Array(CLASSES[number], shape, value)
