"""A topic as a table: one column for each number of its messages, named with index and unit."""

from __future__ import annotations

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
from tonus.tools.run.truth import TOPIC as TRUTH

_NS = 1e-9
_UNITS = {
    (topic.name, field.name): field.unit for topic in (*TABLE, TRUTH) for field in topic.fields
}


@dataclass(frozen=True)
class TableColumn:
    """``name`` is the field's, with an index where it is an array."""

    name: str
    unit: str
    values: NDArray[Any]

    @property
    def title(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def table(topic: str, column: Column, start_ns: int) -> list[TableColumn] | None:
    """Columns (n,) of a topic's messages, the time in s since ``start_ns`` first; None for
    messages that were not decoded, and for states that are not for people."""
    rows = column.messages
    if rows.dtype.names is None or topic == KEYFRAME_TOPIC:
        return None
    columns = [TableColumn("time", "s", (column.times - start_ns) * _NS)]
    for name in rows.dtype.names:
        units = _UNITS.get((topic, name), "").split(", ")
        values = rows[name].reshape(len(rows), -1)
        if rows.dtype[name].shape == ():
            columns.append(TableColumn(name, units[0], rows[name]))
            continue
        size = rows.dtype[name].shape[0]
        for index in range(size):
            # Wrenches have two: forces first, then moments.
            unit = units[index * len(units) // size]
            columns.append(TableColumn(f"{name}_{index}", unit, values[:, index]))
    return columns


def to_arrow(log: Log, topic: str) -> Any:
    """A pyarrow Table of a topic; units stand in its fields' metadata."""
    return arrow_table(_whole(log, topic))


def to_pandas(log: Log, topic: str) -> Any:
    """A pandas DataFrame of a topic."""
    pandas = _optional("pandas", "a DataFrame")
    return pandas.DataFrame({column.name: column.values for column in _whole(log, topic)})


def arrow_table(columns: list[TableColumn]) -> Any:
    """The same of columns that are there already."""
    pyarrow = _optional("pyarrow", "Parquet")
    arrays = [
        pyarrow.array(
            column.values.tolist()
            if column.values.dtype == object
            else np.ascontiguousarray(column.values)
        )
        for column in columns
    ]
    fields = [
        pyarrow.field(column.name, array.type, metadata={"unit": column.unit})
        for column, array in zip(columns, arrays, strict=True)
    ]
    return pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))


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
