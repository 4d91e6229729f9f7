"""Frames described once, and written as a DBC file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

NOBODY = "Vector__XXX"
"""DBC's word where no node is meant."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FLOAT = 1
"""SIG_VALTYPE_: IEEE single"""


@dataclass(frozen=True)
class Signal:
    """Little-endian, from bit ``start``; the physical value is the raw one times ``factor``."""

    name: str
    start: int
    bits: int
    kind: Literal["unsigned", "signed", "real"] = "unsigned"
    factor: float = 1.0
    unit: str = ""
    about: str = ""
    values: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Message:
    identifier: int
    name: str
    sender: str
    receivers: tuple[str, ...]
    length: int
    """bytes"""
    signals: tuple[Signal, ...] = ()
    cycle_ms: int = 0
    """0: not sent periodically"""
    about: str = ""


def write(nodes: Mapping[str, str], messages: Sequence[Message]) -> str:
    """The text of a DBC file; ``nodes`` are names with what they are."""
    return "\n".join(_lines(nodes, messages)) + "\n"


def _lines(nodes: Mapping[str, str], messages: Sequence[Message]) -> Iterator[str]:
    yield from ('VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {' '.join(map(_name, nodes))}")
    for message in messages:
        yield ""
        yield (
            f"BO_ {message.identifier} {_name(message.name)}: {message.length} "
            f"{_name(message.sender)}"
        )
        receivers = ",".join(map(_name, message.receivers)) or NOBODY
        for signal in message.signals:
            sign = "+" if signal.kind == "unsigned" else "-"
            yield (
                f" SG_ {_name(signal.name)} : {signal.start}|{signal.bits}@1{sign} "
                f'({_number(signal.factor)},0) [0|0] "{signal.unit}" {receivers}'
            )
    yield ""
    for name, about in nodes.items():
        yield f"CM_ BU_ {name} {_text(about)};"
    for message in messages:
        if message.about:
            yield f"CM_ BO_ {message.identifier} {_text(message.about)};"
        for signal in message.signals:
            if signal.about:
                yield f"CM_ SG_ {message.identifier} {signal.name} {_text(signal.about)};"
    yield 'BA_DEF_ "BusType" STRING ;'
    yield 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;'
    yield 'BA_DEF_DEF_ "BusType" "CAN";'
    yield 'BA_DEF_DEF_ "GenMsgCycleTime" 0;'
    for message in messages:
        if message.cycle_ms:
            yield f'BA_ "GenMsgCycleTime" BO_ {message.identifier} {message.cycle_ms};'
    for message in messages:
        for signal in message.signals:
            if signal.values:
                table = " ".join(f"{raw} {_text(word)}" for raw, word in signal.values.items())
                yield f"VAL_ {message.identifier} {signal.name} {table} ;"
            if signal.kind == "real":
                yield f"SIG_VALTYPE_ {message.identifier} {signal.name} : {_FLOAT};"


def _name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no name in a DBC file")
    return name


def _number(value: float) -> str:
    return repr(value).removesuffix(".0")


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
