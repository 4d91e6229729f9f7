"""Reading an electronic data sheet (EDS, CiA 306): which objects a device has, and how they begin.

Kept as the sheet has them: types, access, defaults, limits, whether an object can be mapped.
Sections are found whatever the case of their letters.
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from tonus.sim.devices.objects import Entry, Kind, Value
from tonus.sim.errors import LabError

_KINDS = {
    0x01: Kind.U8,  # BOOLEAN, which SDO carries in a byte
    0x02: Kind.I8,
    0x03: Kind.I16,
    0x04: Kind.I32,
    0x05: Kind.U8,
    0x06: Kind.U16,
    0x07: Kind.U32,
    0x08: Kind.REAL32,
    0x09: Kind.STRING,
    0x0A: Kind.STRING,  # OCTET_STRING
    0x0B: Kind.STRING,  # UNICODE_STRING
    0x0F: Kind.STRING,  # DOMAIN, which has no value
    0x11: Kind.REAL64,
    0x15: Kind.I64,
    0x1B: Kind.U64,
}
_WITHOUT_VALUE = frozenset({0x0A, 0x0B, 0x0F})
_DOMAIN = 0x02
_TYPES = (0x05, 0x06)
"""Object types that describe data types and hold no value."""
_ARRAY, _RECORD = 0x08, 0x09
_ACCESS = {
    "ro": ("ro", "t"),
    "wo": ("wo", "r"),
    "rw": ("rw", "rt"),
    "rwr": ("rw", "t"),
    "rww": ("rw", "r"),
    "const": ("const", "t"),
}
"""AccessType to access, and the ways an object goes that can be mapped."""
_OBJECT = re.compile(r"[0-9a-f]{4}")
_PART = re.compile(r"([0-9a-f]{4})sub([0-9a-f]{1,2})")
_LARGEST_SUB = 0xFE

Keys = Mapping[str, str]


@dataclass(frozen=True)
class Sheet:
    """Of one node: ``entries`` by index and subindex, ``names`` of records and arrays."""

    name: str
    """of the file"""
    product_name: str
    node_id: int
    entries: dict[tuple[int, int], Entry] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    stated: frozenset[tuple[int, int]] = frozenset()
    """entries whose default the sheet states"""

    def need(self, index: int, subindex: int, what: str) -> Entry:
        """Raises `LabError` for an object that is not there."""
        entry = self.entries.get((index, subindex))
        if entry is None:
            raise LabError(
                f"{self.name}: has no object 0x{index:04X}:{subindex} ({what}), which an emulated "
                "drive needs; add it, or take another EDS"
            )
        return entry


def read(name: str, text: str, node_id: int) -> Sheet:
    """Raises `LabError`, one line with the file's name and the object."""
    parser = configparser.ConfigParser(interpolation=None, strict=False, allow_no_value=True)
    try:
        parser.read_string(text.lstrip("\ufeff"))
    except configparser.Error as error:
        line = " ".join(str(error).split())
        raise LabError(f"{name}: is no EDS: {line}; correct the line") from error
    sections = {title.lower(): parser[title] for title in parser.sections()}
    if "deviceinfo" not in sections:
        raise LabError(f"{name}: is no EDS: it has no section DeviceInfo; take another file")
    return _Reader(name, sections, node_id).sheet()


class _Reader:
    def __init__(self, name: str, sections: Mapping[str, Keys], node_id: int) -> None:
        self._name = name
        self._sections = sections
        self._node_id = node_id
        self._stated: set[tuple[int, int]] = set()
        self._subs: dict[int, dict[int, Keys]] = {}
        for title, part in sections.items():
            found = _PART.fullmatch(title)
            if found:
                self._subs.setdefault(int(found[1], 16), {})[int(found[2], 16)] = part

    def sheet(self) -> Sheet:
        entries: dict[tuple[int, int], Entry] = {}
        names: dict[int, str] = {}
        for title in sorted(self._sections):
            if not _OBJECT.fullmatch(title):
                continue
            index, keys = int(title, 16), self._sections[title]
            kind = self._number(index, 0, keys.get("objecttype") or "0x7")
            if kind in _TYPES or index < 0x1000:
                continue
            if kind in (_ARRAY, _RECORD) or keys.get("subnumber"):
                names[index] = keys.get("parametername") or f"Object 0x{index:04X}"
                parts = dict(self._parts(index, keys))
            else:
                parts = {0: self._entry(index, 0, keys, domain=kind == _DOMAIN)}
            entries |= {(index, sub): entry for sub, entry in parts.items()}
        product = self._sections["deviceinfo"].get("productname") or self._name
        return Sheet(self._name, product, self._node_id, entries, names, frozenset(self._stated))

    def _parts(self, index: int, keys: Keys) -> Iterator[tuple[int, Entry]]:
        compact = keys.get("compactsubobj")
        if compact:
            count = self._number(index, 0, compact)
            yield 0, Entry("Highest sub-index supported", Kind.U8, "ro", count)
            names = self._sections.get(f"{index:04x}name", {})
            values = self._sections.get(f"{index:04x}value", {})
            for sub in range(1, min(count, _LARGEST_SUB) + 1):
                own = dict(keys) | {"parametername": names.get(str(sub)) or f"Element {sub}"}
                if values.get(str(sub)):
                    own["defaultvalue"] = values[str(sub)]
                yield sub, self._entry(index, sub, own)
            return
        for sub, part in self._subs.get(index, {}).items():
            yield sub, self._entry(index, sub, part)

    def _entry(self, index: int, sub: int, keys: Keys, *, domain: bool = False) -> Entry:
        code = 0x0F if domain else self._number(index, sub, keys.get("datatype") or "")
        kind = _KINDS.get(code)
        if kind is None:
            raise self._wrong(index, sub, f"data type 0x{code:04X} is not emulated", "remove it")
        text = (keys.get("accesstype") or ("rw" if domain else "")).lower()
        if text not in _ACCESS:
            raise self._wrong(index, sub, f"access type {text!r} is unknown", "see CiA 306")
        access, ways = _ACCESS[text]
        value: Value = "" if kind is Kind.STRING else 0.0 if kind.real else 0
        given = keys.get("defaultvalue")
        if given and code not in _WITHOUT_VALUE:
            value = given if kind is Kind.STRING else self._value(index, sub, kind, given)
            self._stated.add((index, sub))
        if isinstance(value, str) and not value.isascii():
            value = value.encode("ascii", "replace").decode("ascii")
        low, high = (
            self._limit(index, sub, kind, keys, name) for name in ("lowlimit", "highlimit")
        )
        mappable = self._number(index, sub, keys.get("pdomapping") or "0") != 0
        name = keys.get("parametername") or f"Object 0x{index:04X}:{sub}"
        entry = Entry(name, kind, access, value, mapping=ways if mappable else "")
        if kind is not Kind.STRING:
            least, most = kind.limits
            entry.low, entry.high = least if low is None else low, most if high is None else high
        entry.relative = given is not None and "$nodeid" in given.lower()
        return entry

    def _limit(self, index: int, sub: int, kind: Kind, keys: Keys, name: str) -> float | None:
        given = keys.get(name)
        if not given or kind is Kind.STRING:
            return None
        return self._value(index, sub, kind, given)

    def _value(self, index: int, sub: int, kind: Kind, given: str) -> float:
        """A number as its type holds it; ``$NODEID`` stands for the node's."""
        if kind.real:
            try:
                return float(given)
            except ValueError as error:
                raise self._wrong(index, sub, f"{given!r} is no number", "correct it") from error
        value = self._number(index, sub, given)
        least, most = kind.limits
        if least < 0 and value > most:
            value -= 1 << 8 * kind.size  # 0xFFFF of a signed type
        if not least <= value <= most:
            raise self._wrong(index, sub, f"{given} does not fit its type", "correct it")
        return value

    def _number(self, index: int, sub: int, given: str) -> int:
        total = 0
        for term in given.replace(" ", "").split("+"):
            if term.lower() == "$nodeid":
                total += self._node_id
                continue
            try:
                # A leading zero is octal in CiA 306; int() takes it only after 0o.
                octal = re.fullmatch(r"0[0-7]+", term)
                total += int(term, 8) if octal else int(term, 0)
            except ValueError as error:
                raise self._wrong(index, sub, f"{given!r} is no number", "correct it") from error
        return total

    def _wrong(self, index: int, sub: int, problem: str, remedy: str) -> LabError:
        return LabError(f"{self._name}: object 0x{index:04X}:{sub}: {problem}; {remedy}")
