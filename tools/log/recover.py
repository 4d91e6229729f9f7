"""A damaged file written anew with all that can be trusted in it, and proved by reading it.

Trusted are chunks whose checksum holds, wherever they stand, and, of a chunk that the file's end
cuts, the whole messages before the cut.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Container
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from numpy.typing import NDArray

from tonus.runtime.recording.mcap_file import Index, McapFile
from tonus.tools.errors import ToolError
from tonus.tools.log.chunks import (
    DamageError,
    Framing,
    Run,
    content,
    data_is_whole,
    read,
    runs,
    scan,
    unpack,
)

TIMING = "/tonus/timing"
_NS = 1e-9
Progress = Callable[[float], None]
"""Receives the share that is done, 0 to 1."""


@dataclass
class Salvage:
    """What was kept, and what is known to be lost."""

    kept: dict[str, int] = field(default_factory=dict)
    """messages by topic"""
    lost: dict[str, int] = field(default_factory=dict)
    """messages by topic, as far as the rest of the file tells"""
    complete: bool = False
    """whether ``lost`` is all: the file told how many there were"""
    beginning_lost: bool = False
    """whether something before the first message kept is lost, and the file does not tell what"""
    chunks_lost: int = 0
    holes: list[tuple[float, float]] = field(default_factory=list)
    """s from the first message on: between these nothing was kept of a topic that is periodic"""
    end_s: float = 0.0
    """s of the last message kept, since the first"""
    ticks: tuple[int, int] | None = None
    """first and last one kept"""


def recover(source: Path, out: Path, progress: Progress = lambda _: None) -> Salvage | None:
    """Write what can be trusted in ``source`` to ``out``; None, and no file, where ``source`` is
    whole. Raises ToolError, also where ``out`` exists: nothing is ever overwritten."""
    framing = scan(source, salvage=True)
    if framing.damage is None and data_is_whole(source, framing):
        return None
    if out.exists():
        raise ToolError(f"{out}: exists already; name another file with --out")
    draft = out.with_name(f".{out.name}.{os.getpid()}.draft")
    try:
        try:
            salvage = _Rewriter(source, framing, draft).run(progress)
            _prove(draft, salvage)
            os.link(draft, out)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; name another file with --out") from error
    return salvage


class _Rewriter:
    def __init__(self, source: Path, framing: Framing, out: Path) -> None:
        self._source, self._framing = source, framing
        used = {place.compression for place in framing.chunks if not place.bare}
        name = used.pop() if len(used) == 1 else "zstd"
        self._file = McapFile(
            out, name or "none", profile=framing.profile, library=f"tonus, {framing.library}"
        )
        self._numbers: dict[int, list[NDArray[np.int64]]] = {}
        self._times: dict[int, list[NDArray[np.int64]]] = {}
        self._ticks: list[int] = []
        self._salvage = Salvage()

    def run(self, progress: Progress) -> Salvage:
        framing, places = self._framing, self._framing.chunks
        # A chunk may announce topics of its own; they are known only when all were unpacked.
        trusted = [self._is_sound(content(self._source, place)) for place in places]
        self._salvage.chunks_lost = trusted.count(False)
        self._salvage.beginning_lost = framing.statistics is None and self._begins_late(trusted)
        known = {n: c for n, c in framing.channels.items() if c.schema_id in {0, *framing.schemas}}
        self._file.adopt(framing.schemas.values(), known.values())
        for name in sorted(framing.attachments):
            self._file.attach(name, framing.attachments[name], framing.media_types[name])
        for name, values in sorted(framing.metadata.items()):
            self._file.metadata(name, values)
        for number, place in enumerate(places):
            data = content(self._source, place) if trusted[number] else None
            if data is not None:
                self._put(data, known)
            progress((number + 1) / len(places))
        if framing.cut is not None:
            beginning = unpack(read(self._source, framing.cut), framing.cut)
            if beginning is not None:
                self._put(beginning, known)
        self._sum_up()
        self._file.metadata("tonus.recovered", {"from": self._source.name})
        self._file.finish()
        return self._salvage

    def _begins_late(self, trusted: list[bool]) -> bool:
        places, resumed = self._framing.chunks, self._framing.resumed
        first = next((place.offset for place, good in zip(places, trusted, strict=True) if good), 0)
        return not all(trusted[:1]) or any(at <= first for at in resumed)

    def _is_sound(self, data: bytes | None) -> bool:
        if data is None:
            return False
        try:
            for _ in runs(data, self._framing):
                pass
        except DamageError:
            return False
        return True

    def _put(self, data: bytes, known: Container[int]) -> None:
        """Copy the whole messages of a chunk."""
        kept: list[Run] = []
        with suppress(DamageError):  # of a cut chunk's last record
            for run in runs(data, self._framing):
                kept += [run] if run.channel in known else []
        if not kept:
            return
        places, at = [], 0
        for run in kept:
            offsets = at + run.rows.shape[1] * np.arange(len(run.rows))
            places.append(Index(run.channel, run.log_time, offsets))
            at += run.rows.size
            self._note(run)
        packed = b"".join(run.rows.tobytes() for run in kept)
        self._file.records(memoryview(packed), places)

    def _note(self, run: Run) -> None:
        self._numbers.setdefault(run.channel, []).append(run.sequence)
        self._times.setdefault(run.channel, []).append(run.log_time)
        topic = self._framing.channels[run.channel].topic
        self._salvage.kept[topic] = self._salvage.kept.get(topic, 0) + len(run.rows)
        if topic == TIMING:
            ticks = run.data[:, 4:12].copy().view("<u8")[:, 0]
            self._ticks += [int(ticks[0]), int(ticks[-1])]

    def _sum_up(self) -> None:
        salvage, framing = self._salvage, self._framing
        statistics = framing.statistics
        salvage.complete = statistics is not None
        times = [each for parts in self._times.values() for each in parts]
        if times:
            first = min(int(each.min()) for each in times)
            salvage.end_s = (max(int(each.max()) for each in times) - first) * _NS
        if self._ticks:
            salvage.ticks = min(self._ticks), max(self._ticks)
        gaps = self._gaps()
        salvage.holes = [((start - first) * _NS, (end - first) * _NS) for start, end in gaps]
        if statistics is None:
            for channel in self._numbers:
                salvage.lost[framing.channels[channel].topic] = self._missing(channel, gaps)
        else:
            for channel, count in statistics.channel_message_counts.items():
                if channel in framing.channels:
                    topic = framing.channels[channel].topic
                    before = salvage.lost.get(topic, 0)
                    got = sum(map(len, self._numbers.get(channel, [])))
                    salvage.lost[topic] = before + max(int(count) - got, 0)
        salvage.lost = {topic: count for topic, count in salvage.lost.items() if count}

    def _gaps(self) -> list[tuple[int, int]]:
        """Between which two times (ns) the numbers of the periodic topic step."""
        found: list[tuple[int, int]] = []
        for channel, parts in self._numbers.items():
            if self._framing.channels[channel].topic == TIMING:
                stamps = np.concatenate(self._times[channel])
                at = np.flatnonzero(np.diff(np.concatenate(parts)) > 1)
                found += [(int(stamps[k]), int(stamps[k + 1])) for k in at]
        return found

    def _missing(self, channel: int, gaps: list[tuple[int, int]]) -> int:
        """How many messages the numbers of a topic leave out between the first and the last one.

        A topic need not begin with 0: a later file of a run does not, nor does a scene, which
        begins with the first pose.
        """
        topic = self._framing.channels[channel].topic
        # Bus frames are numbered through all buses, so a step says nothing about one of them.
        if topic.startswith("/can/"):
            return 0
        steps = np.diff(np.concatenate(self._numbers[channel])) - 1
        if not topic.startswith("/tonus/") and self._ticks:
            # Numbered by ticks: what has none in a tick, or a tick that was missed, is no loss.
            stamps = np.concatenate(self._times[channel])
            torn = np.zeros(len(steps), bool)
            for start, end in gaps:
                torn |= (stamps[:-1] <= end) & (stamps[1:] >= start)
            steps = steps[torn]
        return int(np.maximum(steps, 0).sum())


def _prove(path: Path, salvage: Salvage) -> None:
    """Read every message with the mcap package, checksums and all. Raises ToolError."""
    counted: dict[str, int] = {}
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            for _, channel, _ in reader.iter_messages(log_time_order=False):
                counted[channel.topic] = counted.get(channel.topic, 0) + 1
    except McapError as error:
        raise ToolError(f"{path}: what was recovered cannot be read ({error})") from error
    framing = scan(path)
    if counted != salvage.kept or framing.damage or not data_is_whole(path, framing):
        raise ToolError(f"{path}: what was recovered is not what was written")
