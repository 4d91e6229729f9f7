"""Topics as a .mat file of version 5, which MATLAB, Octave and scipy read: a struct for each.

MATLAB stores a field as a whole and a log a tick at a time, so fields are gathered in files beside
it, a chunk of the log at a time; in memory are one chunk and, at the end, one field.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.io.matlab import MatWriteError

from tonus.tools.errors import ToolError
from tonus.tools.log.tables import Signal

LARGEST = 1 << 31
"""bytes of a variable, as far as MATLAB reads this version
(mathworks.com/help/matlab/import_export/mat-file-versions.html)"""
_LONGEST = 63
"""characters of a name, MATLAB's namelengthmax"""
_KEYWORDS = frozenset(
    [
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
        "otherwise",
        "parfor",
        "persistent",
        "return",
        "spmd",
        "switch",
        "try",
        "while",
    ]
)
"""MATLAB's iskeyword"""


def legal(name: str, taken: Iterable[str] = ()) -> str:
    """A name as MATLAB allows it, of a variable or field, and none of those ``taken``."""
    text = re.sub(r"\W", "_", name, flags=re.ASCII).lstrip("_")
    if not text or not text[0].isalpha() or text in _KEYWORDS:
        text = f"x{text}"
    text, others = text[:_LONGEST], set(taken)
    unique, number = text, 2
    while unique in others:
        tail = f"_{number}"
        unique, number = text[: _LONGEST - len(tail)] + tail, number + 1
    return unique


@dataclass
class _Spool:
    """A field while its chunks come."""

    unit: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    """of one message's"""
    path: Path
    file: BinaryIO
    count: int = 0


class _Late:
    """A field as an array that is read when it is written, and not before: one at a time."""

    def __init__(self, spool: _Spool) -> None:
        self._spool = spool

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        values = np.fromfile(self._spool.path, self._spool.dtype)
        return values.reshape(self._spool.count, *self._spool.shape)


@dataclass
class _Struct:
    spools: dict[str, _Spool] = field(default_factory=dict)
    texts: dict[str, list[Any]] = field(default_factory=dict)
    """of any length, as events have them: a cell each"""
    bytes: int = 0


class Matlab:
    """A .mat file while it is filled. `write` makes it; `close` lets go of what is beside it."""

    def __init__(self, path: Path, source: Path) -> None:
        """``source``: the log, for errors. Raises OSError."""
        self._path, self._source = path, source
        self._structs: dict[str, _Struct] = {}
        self._names: dict[str, str] = {}
        self._beside = TemporaryDirectory(prefix=".mat.", dir=path.parent)

    def close(self) -> None:
        for struct in self._structs.values():
            for spool in struct.spools.values():
                spool.file.close()
        self._beside.cleanup()

    def add(self, variable: str, signals: Sequence[Signal]) -> None:
        """Go on with the fields of a variable. Raises ToolError for what MATLAB could not read."""
        if variable not in self._names:
            self._names[variable] = legal(variable, self._names.values())
        struct = self._structs.setdefault(self._names[variable], _Struct())
        for signal in signals:
            values = _array(signal)
            if values.dtype == object:
                struct.texts.setdefault(signal.name, []).extend(values.tolist())
                continue
            if signal.name not in struct.spools:
                path = Path(self._beside.name) / f"{len(self._structs)}.{len(struct.spools)}"
                struct.spools[signal.name] = _Spool(
                    signal.unit, values.dtype, values.shape[1:], path, path.open("wb")
                )
            spool = struct.spools[signal.name]
            if (values.dtype, values.shape[1:]) != (spool.dtype, spool.shape):
                raise ToolError(
                    f"{self._source}: {variable} is not the same in all of the run; export a part "
                    "of it with --from and --to"
                )
            spool.file.write(np.ascontiguousarray(values).data)
            spool.count += len(values)
            struct.bytes += values.nbytes
        if struct.bytes > LARGEST - (1 << 20):
            raise ToolError(
                f"{self._source}: {variable} takes more than the 2 GB that a variable of a .mat "
                "file may; export a part of it with --from and --to, or --format parquet"
            )

    def write(self, about: Mapping[str, Any]) -> None:
        """Write the file, with a struct of what describes the run. Raises OSError, ToolError."""
        tree: dict[str, Any] = {name: _tree(struct) for name, struct in self._structs.items()}
        tree[legal("about", tree)] = _described(about)
        try:
            with self._path.open("wb") as file:
                savemat(file, tree, long_field_names=True, oned_as="column")
        except MatWriteError as error:
            raise ToolError(f"{self._path}: {error}; choose --format parquet") from error


def _array(signal: Signal) -> NDArray[Any]:
    """Its numbers, or its names as characters of one width."""
    if signal.names is None:
        return signal.values
    names = np.array([name.encode() for name in signal.names], f"S{signal.width}")
    padded = np.char.ljust(names, signal.width)  # scipy would do it in a copy of them all
    found: NDArray[Any] = padded[signal.values]
    return found


def _tree(struct: _Struct) -> dict[str, Any]:
    """Fields by legal names, and their units."""
    fields: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name, spool in struct.spools.items():
        spool.file.flush()
        place = legal(name, fields)
        fields[place] = _Late(spool)
        if spool.unit:
            units[place] = spool.unit
    for name, texts in struct.texts.items():
        cells = np.empty((len(texts), 1), object)
        cells[:, 0] = texts
        fields[legal(name, fields)] = cells
    if units:
        fields[legal("units", fields)] = units
    return fields


def _described(about: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in about.items():
        found[legal(name, found)] = value
    return found
