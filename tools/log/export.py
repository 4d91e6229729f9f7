"""A log in the formats of others: tables as CSV, Parquet or .mat, bus frames as .asc or .blf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tonus.tools.draft import drafted
from tonus.tools.errors import ToolError
from tonus.tools.log.bus_frames import BUS, write_frames
from tonus.tools.log.log import Log
from tonus.tools.log.matlab import Matlab
from tonus.tools.log.merged import merge, mergeable
from tonus.tools.log.table_files import MAKERS, TableFile
from tonus.tools.log.tables import Signal, signals, table, time_of

TABLES, FRAMES = ("csv", "parquet", "mat"), ("asc", "blf")
FORMATS = (*TABLES, *FRAMES)
Written = dict[str, Path | None]
T = TypeVar("T")


@dataclass(frozen=True)
class Merged:
    """What became of the ticks of a log."""

    path: Path
    rows: int
    left_out: int
    """before the first message of a topic"""


def export(log: Log, out: Path, kind: str, topics: Sequence[str] = ()) -> Written:
    """Write ``topics`` (all, if none are named) to the folder ``out``; gives the file of each
    topic, None for one that makes no table. Raises ToolError, also where a file exists."""
    chosen = [log.named(topic) for topic in topics] or list(log.topics)
    if kind in FRAMES:
        chosen = [topic for topic in chosen if topic.startswith(BUS)]
        if not chosen:
            raise ToolError(f"{log.path}: no bus frames in it, so there is nothing for .{kind}")
        return _into(out, lambda: _frames(log, chosen, out, kind))
    if kind == "mat":
        return _into(out, lambda: _matlab(log, chosen, out))
    return _into(out, lambda: _tables(log, chosen, out, kind))


def export_merged(log: Log, out: Path, kind: str, topics: Sequence[str] = ()) -> Merged:
    """Write one table of ``topics`` with a row a tick (`merge`) to the folder ``out``. Raises
    ToolError, also where the file exists or no tick has a value of every topic."""
    if kind not in TABLES:
        raise ToolError(f"--merge makes a table, and .{kind} holds none; choose another --format")
    chosen = mergeable(log, topics)
    return _into(out, lambda: _merged(log, chosen, out, kind))


def _into(out: Path, write: Callable[[], T]) -> T:
    """Write into a folder, of which nothing is left if that fails."""
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        try:
            return write()
        finally:
            if made and not any(out.iterdir()):
                out.rmdir()
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another folder with --out") from error


def _frames(log: Log, topics: Sequence[str], out: Path, kind: str) -> Written:
    path = _new(out / f"{log.path.stem}.{kind}")
    with drafted(path) as beside:
        write_frames(log, topics, beside, kind)
    return dict.fromkeys(topics, path)


def _tables(log: Log, topics: Sequence[str], out: Path, kind: str) -> Written:
    written: Written = dict.fromkeys(topics)
    # All tables appear together, once each of them is whole.
    with ExitStack() as drafts, ExitStack() as files:
        writers: dict[str, TableFile] = {}
        for batch in log.batches(topics):
            for topic, column in batch.items():
                columns = table(topic, column, log.start_ns) if len(column.times) else None
                if columns is None:
                    continue
                if topic not in writers:
                    path = written[topic] = _new(out / f"{_plain(topic)}.{kind}")
                    beside = drafts.enter_context(drafted(path))
                    writers[topic] = files.enter_context(closing(MAKERS[kind](beside, columns)))
                writers[topic].write(columns)
    return written


def _matlab(log: Log, topics: Sequence[str], out: Path) -> Written:
    written: Written = dict.fromkeys(topics)
    path = _new(out / f"{log.path.stem}.mat")
    with drafted(path) as beside, closing(Matlab(beside, log.path)) as file:
        for batch in log.batches(topics):
            for topic, column in batch.items():
                found = signals(topic, column) if len(column.times) else None
                if found is not None:
                    written[topic] = path
                    file.add(_plain(topic), [time_of(column, log.start_ns), *found])
        file.write(_about(log))
    return written


def _merged(log: Log, topics: Sequence[str], out: Path, kind: str) -> Merged:
    path = _new(out / f"merged.{kind}")
    rows = left_out = 0
    with drafted(path) as beside, ExitStack() as files:
        matlab = files.enter_context(closing(Matlab(beside, log.path))) if kind == "mat" else None
        writer: TableFile | None = None
        for part in merge(log, topics):
            left_out += part.left_out
            rows += part.count
            if not part.count:
                continue
            if matlab is not None:
                _add(matlab, part.base, part.topics)
                continue
            if writer is None:
                writer = files.enter_context(closing(MAKERS[kind](beside, part.columns())))
            writer.write(part.columns())
        if not rows:
            raise ToolError(f"{log.path}: no tick has a value of every topic; name fewer --topics")
        if matlab is not None:
            matlab.write(_about(log))
    return Merged(path, rows, left_out)


def _add(file: Matlab, base: Sequence[Signal], topics: dict[str, list[Signal]]) -> None:
    file.add("ticks", base)
    for topic, fields in topics.items():
        file.add(topic, fields)


def _about(log: Log) -> dict[str, Any]:
    """Where the numbers come from; ``start_ns`` is the log_time of time 0."""
    return {"file": log.path.name, "start_ns": log.start_ns, **log.metadata}


def _plain(topic: str) -> str:
    """As part of a file's name, or of a variable's."""
    return topic.strip("/").replace("/", "_")


def _new(path: Path) -> Path:
    if path.exists():
        raise ToolError(f"{path}: exists already; choose another folder with --out")
    return path
