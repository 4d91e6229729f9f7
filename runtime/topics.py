"""Topics described once: a numpy dtype, a ROS 2 message definition and a line of documentation
come from the same table.

A topic is a flat record of fixed-size fields, widest first, so that its packed numpy layout is byte
for byte the CDR body: CDR aligns a member from the start of the body and pads nothing at the end.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from functools import cache

import numpy as np

from tonus.config.cables import cells_of

_WIDTH = {
    "float64": 8,
    "int64": 8,
    "uint64": 8,
    "float32": 4,
    "int32": 4,
    "uint32": 4,
    "int16": 2,
    "uint16": 2,
    "uint8": 1,
    "int8": 1,
}


class Per(IntEnum):
    """In place of a size, until the robot is known: an array with one value for each of them."""

    CABLE = -1
    CELL = -2

    def count(self, cables: int) -> int:
        """Of a robot with so many cables."""
        return cables if self is Per.CABLE else cells_of(cables)


@dataclass(frozen=True)
class Field:
    """One signal: ``size`` is 0 for a scalar, otherwise the length of a fixed array, or a `Per`."""

    name: str
    type: str
    size: int
    unit: str
    doc: str

    @property
    def width(self) -> int:
        return _WIDTH[self.type]

    def sized(self, cables: int) -> Field:
        """As it is for a robot with so many cables."""
        return replace(self, size=Per(self.size).count(cables)) if self.size < 0 else self


@dataclass(frozen=True)
class Topic:
    """A named group of signals of one tick, logged as one message."""

    name: str
    message: str
    doc: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        widths = [field.width for field in self.fields]
        if widths != sorted(widths, reverse=True):
            raise ValueError(f"{self.name}: fields must stand widest first")

    def sized(self, cables: int) -> Topic:
        """As it is for a robot with so many cables; what follows needs that."""
        return replace(self, fields=tuple(field.sized(cables) for field in self.fields))

    @property
    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(
            [
                (f.name, f"<{np.dtype(f.type).str[1:]}", (f.size,) if f.size else ())
                for f in self.fields
            ]
        )

    @property
    def definition(self) -> str:
        """The ROS 2 message definition, with unit and meaning as comments."""
        lines = []
        for f in self.fields:
            array = f"[{f.size}]" if f.size else ""
            unit = f"{f.unit}: " if f.unit else ""
            lines.append(f"{f.type}{array} {f.name}  # {unit}{f.doc}")
        return "\n".join(lines) + "\n"


def record_dtype(topics: Sequence[Topic]) -> np.dtype[np.void]:
    """One record that holds every topic's message side by side; the member's name is the last
    part of the topic's."""
    return np.dtype([(topic.name.rsplit("/", 1)[1], topic.dtype) for topic in topics])


def to_json(topics: Sequence[Topic]) -> str:
    """For the head of a ring file."""
    return _to_json(tuple(topics))


@cache
def _to_json(topics: tuple[Topic, ...]) -> str:
    return json.dumps([asdict(topic) for topic in topics], sort_keys=True)


@cache
def from_json(text: str) -> tuple[Topic, ...]:
    """The inverse of `to_json`."""
    return tuple(
        Topic(t["name"], t["message"], t["doc"], tuple(Field(**f) for f in t["fields"]))
        for t in json.loads(text)
    )
