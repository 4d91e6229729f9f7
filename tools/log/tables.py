"""A topic as a table: one column for each number of its messages, named with index and unit, and
one of names beside each column of states or other enumerations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.messages import KEYFRAME_TOPIC
from tonus.runtime.signals import TABLE
from tonus.tools.errors import ToolError
from tonus.tools.log.decode import Column
from tonus.tools.log.log import Log
from tonus.tools.log.names import ENUMERATIONS, SUFFIX, longest, named
from tonus.tools.run.truth import TOPIC as TRUTH

_NS = 1e-9
_UNITS = {
    (topic.name, field.name): field.unit for topic in (*TABLE, TRUTH) for field in topic.fields
}


@dataclass(frozen=True)
class Signal:
    """One field of a topic's messages."""

    name: str
    unit: str
    """of an array with unlike ones: each of them, with commas between"""
    values: NDArray[Any]
    """(n,), or (n, size) of an array"""
    names: tuple[str, ...] | None = None
    """of an enumeration: ``values`` are places in it"""
    width: int = 0
    """characters of the longest name that can come"""

    def columns(self, prefix: str = "") -> list[TableColumn]:
        """One for each element."""
        if self.values.ndim == 1:
            return [TableColumn(f"{prefix}{self.name}", self.unit, self.values, self.names)]
        units, flat = self.unit.split(", "), self.values.reshape(len(self.values), -1)
        size = flat.shape[1]
        # Wrenches have two units: of the forces first, then of the moments.
        return [
            TableColumn(
                f"{prefix}{self.name}_{index}",
                units[index * len(units) // size],
                flat[:, index],
                self.names,
            )
            for index in range(size)
        ]


@dataclass(frozen=True)
class TableColumn:
    """``name`` is the field's, with an index where it is an array."""

    name: str
    unit: str
    values: NDArray[Any]
    names: tuple[str, ...] | None = None
    """of a column of text: ``values`` are places in it"""

    @property
    def title(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def cells(self) -> list[Any]:
        """Its numbers or texts."""
        if self.names is None:
            cells: list[Any] = self.values.tolist()
            return cells
        return [self.names[place] for place in self.values.tolist()]


def signals(topic: str, column: Column) -> list[Signal] | None:
    """The fields of a topic's messages, without their time; names behind the numbers they belong
    to. None for messages that were not decoded, and for states that are not for people."""
    rows = column.messages
    if rows.dtype.names is None or topic == KEYFRAME_TOPIC:
        return None
    found: list[Signal] = []
    for name in rows.dtype.names:
        found.append(Signal(name, _UNITS.get((topic, name), ""), rows[name]))
        enumeration = ENUMERATIONS.get((topic, name))
        free = f"{name}{SUFFIX}" not in rows.dtype.names
        if enumeration is not None and free and rows.dtype[name].base.kind in "iu":
            places, names = named(enumeration, rows[name])
            found.append(Signal(f"{name}{SUFFIX}", "", places, names, longest(enumeration)))
    return found


def time_of(column: Column, start_ns: int) -> Signal:
    """The messages' times in s since ``start_ns``."""
    return Signal("time", "s", (column.times - start_ns) * _NS)


def table(topic: str, column: Column, start_ns: int) -> list[TableColumn] | None:
    """Columns (n,) of a topic's messages, the time in s since ``start_ns`` first; None for what
    `signals` gives none of."""
    found = signals(topic, column)
    if found is None:
        return None
    return [each for signal in (time_of(column, start_ns), *found) for each in signal.columns()]


def to_arrow(log: Log, topic: str) -> Any:
    """A pyarrow Table of a topic; units stand in its fields' metadata."""
    return arrow_table(_whole(log, topic))


def to_pandas(log: Log, topic: str) -> Any:
    """A pandas DataFrame of a topic; names are categories."""
    pandas = _optional("pandas", "a DataFrame")
    return pandas.DataFrame(
        {
            column.name: column.values
            if column.names is None
            else pandas.Categorical.from_codes(column.values, column.names)
            for column in _whole(log, topic)
        }
    )


def arrow_table(columns: Sequence[TableColumn]) -> Any:
    """The same of columns that are there already."""
    pyarrow = _optional("pyarrow", "Parquet")
    arrays = [_arrow(pyarrow, column) for column in columns]
    fields = [
        pyarrow.field(column.name, array.type, metadata={"unit": column.unit})
        for column, array in zip(columns, arrays, strict=True)
    ]
    return pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))


def arrow_tables(parts: Sequence[Sequence[TableColumn]]) -> Any:
    """One of several, one below the other."""
    tables = [arrow_table(columns) for columns in parts]
    return _optional("pyarrow", "Parquet").concat_tables(tables)


def _arrow(pyarrow: Any, column: TableColumn) -> Any:
    if column.names is not None:
        places = pyarrow.array(column.values.astype(np.int32))
        return pyarrow.array(column.names, pyarrow.string()).take(places)
    if column.values.dtype == object:
        return pyarrow.array(column.cells)
    return pyarrow.array(np.ascontiguousarray(column.values))


def parquet_writer(path: str, schema: Any) -> Any:
    """A pyarrow ParquetWriter."""
    _optional("pyarrow", "Parquet")
    return _optional("pyarrow.parquet", "Parquet").ParquetWriter(path, schema)


def _whole(log: Log, topic: str) -> list[TableColumn]:
    column = Column(log[topic], log.times(topic), log.sequence(topic))
    columns = table(topic, column, log.start_ns)
    if columns is None:
        raise ToolError(
            f"{log.path}: messages of {topic} are not of one size, so they make no table"
        )
    return columns


def _optional(name: str, what: str) -> ModuleType:

    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise ToolError(f"{what} needs {package}: pip install {package}") from error
