"""A log in the formats of others: tables as CSV or Parquet, bus frames as .asc or .blf."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TextIO

import can
import numpy as np
from can.io import ASCWriter, BLFWriter

from tonus.tools.draft import drafted
from tonus.tools.errors import ToolError
from tonus.tools.log.decode import Column
from tonus.tools.log.log import Log
from tonus.tools.log.tables import TableColumn, arrow_table, parquet_writer, table

BUS = "/can/"
_NS = 1e-9
_SECOND = 1_000_000_000
FORMATS = ("csv", "parquet", "asc", "blf")


def export(log: Log, out: Path, kind: str, topics: Sequence[str] = ()) -> dict[str, Path | None]:
    """Write ``topics`` (all, if none are named) to the folder ``out``; gives the file of each
    topic, None for one that makes no table. Raises ToolError, also where a file exists."""
    chosen = list(topics) or list(log.topics)
    if kind in ("asc", "blf"):
        chosen = [topic for topic in chosen if topic.startswith(BUS)]
        if not chosen:
            raise ToolError(f"{log.path}: no bus frames in it, so there is nothing for .{kind}")
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        try:
            if kind in ("asc", "blf"):
                path = _new(out / f"{log.path.stem}.{kind}")
                with drafted(path) as beside:
                    _frames(log, chosen, beside, kind)
                return dict.fromkeys(chosen, path)
            return _tables(log, chosen, out, kind)
        finally:
            if made and not any(out.iterdir()):
                out.rmdir()
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another folder with --out") from error


def _tables(log: Log, topics: Sequence[str], out: Path, kind: str) -> dict[str, Path | None]:
    make: type[_Csv | _Parquet] = _Csv if kind == "csv" else _Parquet
    written: dict[str, Path | None] = dict.fromkeys(topics)
    # All tables appear together, once each of them is whole.
    with ExitStack() as drafts, ExitStack() as files:
        writers: dict[str, _Csv | _Parquet] = {}
        for batch in log.batches(topics):
            for topic, column in batch.items():
                columns = table(topic, column, log.start_ns) if len(column.times) else None
                if columns is None:
                    continue
                if topic not in writers:
                    name = topic.strip("/").replace("/", "_")
                    path = written[topic] = _new(out / f"{name}.{kind}")
                    beside = drafts.enter_context(drafted(path))
                    writers[topic] = files.enter_context(closing(make(beside, columns)))
                writers[topic].write(columns)
    return written


class _Csv:
    """Floats are written in as many digits as give them back exactly."""

    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        self._file: TextIO = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self._writer.writerow(column.title for column in columns)

    def close(self) -> None:
        self._file.close()

    def write(self, columns: list[TableColumn]) -> None:
        values = [column.values.tolist() for column in columns]
        self._writer.writerows(zip(*values, strict=True))


class _Parquet:
    def __init__(self, path: Path, columns: list[TableColumn]) -> None:
        self._writer = parquet_writer(str(path), arrow_table(columns).schema)

    def close(self) -> None:
        self._writer.close()

    def write(self, columns: list[TableColumn]) -> None:
        self._writer.write_table(arrow_table(columns))


def _frames(log: Log, topics: Sequence[str], path: Path, kind: str) -> None:
    """All buses into one file; channel numbers count the topics."""
    # Both formats keep the beginning to a millisecond only, and frames relative to it.
    begin = log.start_ns // _SECOND
    writer: ASCWriter | BLFWriter
    if kind == "blf":
        writer = BLFWriter(path)
        writer.start_timestamp = float(begin)
    else:
        writer = ASCWriter(path)
        writer.log_event("Start of log", float(begin))
    with writer:
        for batch in log.batches(topics):
            for message in _messages(batch, topics):
                writer.on_message_received(message)


def _messages(batch: dict[str, Column], topics: Sequence[str]) -> Iterator[can.Message]:
    """Frames of a batch in the order in which they were on the buses."""
    parts = [(number, batch[topic]) for number, topic in enumerate(topics)]
    usable = [(n, c) for n, c in parts if c.messages.dtype.names is not None and len(c.times)]
    if not usable:
        return
    number = np.concatenate([np.full(len(c.times), n) for n, c in usable])
    row = np.concatenate([np.arange(len(c.times)) for _, c in usable])
    times = np.concatenate([c.times for _, c in usable])
    sequence = np.concatenate([c.sequence for _, c in usable])
    tables = {n: c.messages.tolist() for n, c in usable}
    stamps = (times * _NS).tolist()
    for index in np.lexsort((sequence, times)).tolist():
        _, _, identifier, remote, extended, error, dlc, data = tables[int(number[index])][
            int(row[index])
        ]
        yield can.Message(
            timestamp=stamps[index],
            arbitration_id=identifier,
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=error,
            channel=int(number[index]),
            dlc=dlc,
            data=None if remote else bytes(data[:dlc]),
        )


def _new(path: Path) -> Path:
    if path.exists():
        raise ToolError(f"{path}: exists already; choose another folder with --out")
    return path
