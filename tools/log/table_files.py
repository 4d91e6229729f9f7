"""Tables as files: CSV and Parquet, written a chunk of the log at a time."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, TextIO

from tonus.tools.log.tables import TableColumn, arrow_table, arrow_tables, parquet_writer

_GROUP = 20_000
"""rows that are written together: every group costs a reader memory for each column"""


class TableFile(Protocol):
    """A table while it is written."""

    def write(self, columns: Sequence[TableColumn]) -> None:
        """Append rows; every call has the same columns."""

    def close(self) -> None: ...


class Csv:
    """Floats are written in as many digits as give them back exactly."""

    def __init__(self, path: Path, columns: Sequence[TableColumn]) -> None:
        self._file: TextIO = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self._writer.writerow(column.title for column in columns)

    def close(self) -> None:
        self._file.close()

    def write(self, columns: Sequence[TableColumn]) -> None:
        self._writer.writerows(zip(*(column.cells for column in columns), strict=True))


class Parquet:
    """Units stand in the metadata of its fields."""

    def __init__(self, path: Path, columns: Sequence[TableColumn]) -> None:
        self._writer = parquet_writer(str(path), arrow_table(columns).schema)
        self._waiting: list[list[TableColumn]] = []
        self._rows = 0

    def close(self) -> None:
        try:
            self._write()
        finally:
            self._writer.close()

    def write(self, columns: Sequence[TableColumn]) -> None:
        self._waiting.append(list(columns))
        self._rows += len(columns[0].values)
        if self._rows >= _GROUP:
            self._write()

    def _write(self) -> None:
        if self._waiting:
            self._writer.write_table(arrow_tables(self._waiting), row_group_size=2 * _GROUP)
        self._waiting, self._rows = [], 0


MAKERS: dict[str, type[Csv | Parquet]] = {"csv": Csv, "parquet": Parquet}
