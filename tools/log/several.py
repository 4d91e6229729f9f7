"""Several files of one run, read as one."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tonus.tools.errors import ToolError
from tonus.tools.log.chunks import scan
from tonus.tools.log.decode import Column, joined
from tonus.tools.log.log import Log


def segments(first: Path) -> list[Path]:
    """A file and those its recorder went on to, in order. Raises ToolError."""
    return gather(first)[0]


def gather(first: Path) -> tuple[list[Path], tuple[str, ...]]:
    """The same, and in words what stands beside them or is missing there. Raises ToolError."""
    pattern = re.compile(re.escape(first.stem) + r"\.([1-9]\d*)" + re.escape(first.suffix))
    matches = [(pattern.fullmatch(path.name), path) for path in first.parent.glob("*")]
    numbered = sorted((int(match[1]), path) for match, path in matches if match is not None)
    found, remarks, expected = [first], [], 2
    run = _run(first) if numbered else {}
    for number, path in numbered:
        remarks += [f"{first.stem}.{n}{first.suffix} is missing" for n in range(expected, number)]
        expected = number + 1
        try:
            same = _run(path) == run
            remark = f"{path.name} is of another run or damaged at its head, and left out"
        except ToolError as error:
            same, remark = False, f"{error}; left out"
        if same:
            found.append(path)
        else:
            remarks.append(remark)
    return found, tuple(remarks)


def _run(path: Path) -> dict[str, str]:
    """What the files of one run have in common, and no other. Raises ToolError."""
    metadata = scan(path).metadata.get("tonus", {})
    return {key: value for key, value in metadata.items() if key != "file"}


class SeveralLogs(Log):
    """Segments in order of time. What describes the run comes from the first."""

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__(paths[0])
        logs = [Log(path) for path in paths]
        self._logs = sorted(logs, key=lambda log: log.span_ns or (0, 0))
        self.path = self._logs[0].path
        self._framing = self._logs[0]._framing

    @property
    def topics(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(topic for log in self._logs for topic in log.topics))

    @property
    def recorded(self) -> dict[str, str]:
        """Summed up."""
        total: dict[str, int] = {}
        for log in self._logs:
            for name, count in log.recorded.items():
                total[name] = total.get(name, 0) + int(count)
        return {name: str(count) for name, count in total.items()}

    @property
    def start_ns(self) -> int:
        return min(log.start_ns for log in self._logs)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        spans = [log.span_ns for log in self._logs]
        known = [span for span in spans if span is not None]
        return (min(s[0] for s in known), max(s[1] for s in known)) if known else None

    @property
    def damage(self) -> str | None:
        told = [f"{log.path.name}: {log.damage}" for log in self._logs if log.damage]
        told += self.remarks
        return "; ".join(told) or None

    def is_as_written(self) -> bool:
        return all(log.is_as_written() for log in self._logs)

    def load(self, topics: Sequence[str] | None = None) -> None:
        names = [name for name in self._known(topics) if name not in self._columns]
        for log in self._logs:
            log.load([name for name in names if name in log])
        for name in names:
            self._columns[name] = self._joined(name)

    def batches(self, topics: Sequence[str]) -> Iterator[dict[str, Column]]:
        names = self._known(topics)
        for log in self._logs:
            yield from log.batches([name for name in names if name in log])

    def batches_in_time(self, topics: Sequence[str]) -> Iterator[tuple[int, dict[str, Column]]]:
        names = self._known(topics)
        for number, log in enumerate(self._logs):
            spans = [later.span_ns for later in self._logs[number + 1 :]]
            starts = [span[0] for span in spans if span is not None]
            for until, batch in log.batches_in_time([name for name in names if name in log]):
                yield min([until, *starts]), batch

    @property
    def chunk_count(self) -> int:
        return sum(log.chunk_count for log in self._logs)

    def between(self, start_s: float, end_s: float) -> Log:
        part = copy.copy(self)
        part._columns = {}
        lags = [(log.start_ns - self.start_ns) * 1e-9 for log in self._logs]
        part._logs = [
            log.between(start_s - lag, end_s - lag)
            for log, lag in zip(self._logs, lags, strict=True)
        ]
        return part

    def _joined(self, topic: str) -> Column:
        columns = [log._columns.pop(topic) for log in self._logs if topic in log]
        if len({column.messages.dtype for column in columns if len(column.times)}) > 1:
            raise ToolError(f"{self.path}: {topic} differs between the files; open them one by one")
        filled = [column for column in columns if len(column.times)]
        return joined(filled or columns[:1])
