"""From rings to MCAP files: copies what is new, closes a chunk when its stretch of run time is
over, and only then moves the readers' cursors.

Which chunk a record goes to follows from its stamp alone, and a chunk stays open for one more
chunk's time for what arrives late; so the files' bytes do not depend on when or how often `drain`
is called.

A file that has grown large or long is followed by another. Where the disk has no room the recorder
stops, the last file stays whole, and recording goes on in another one when there is room again:
what the rings still hold by then is not lost.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Recording
from tonus.runtime.recording.mcap_file import Block
from tonus.runtime.recording.messages import Encoder
from tonus.runtime.recording.ring import RingReader
from tonus.runtime.recording.segment import CYCLE_RING, Segment, cycle_dtype, next_name
from tonus.runtime.recording.taps import EVENT, Level
from tonus.runtime.recording.viewer import Scene

Watch = Callable[[np.void, int], None]
"""Receives the newest cycle record and its stamp in ns."""

_MEGABYTE = 1_000_000
_ROOM = 16 * _MEGABYTE
"""bytes beyond the configured ones that must be free before a stopped recording goes on"""


class _Source:
    """One ring. It is also the buffer: records stay in it until their chunk is complete."""

    def __init__(self, reader: RingReader, encode: Encoder) -> None:
        self.reader = reader
        self.encode = encode
        self.latest: int | None = None
        """ns, the highest stamp seen so far"""
        self._stamps = np.empty(0, np.int64)

    def look(self) -> int:
        """Take note of what is new; gives how many records."""
        known = self.reader.position + len(self._stamps)
        first, new = self.reader.stamps(known)
        if not len(new):
            return 0
        # The ring's order decides, so a record goes with the latest stamp before it.
        floor = new[0] if self.latest is None else self.latest
        new = np.maximum.accumulate(np.maximum(new, floor))
        overwritten = np.full(first - known, new[0])
        self._stamps = np.concatenate((self._stamps, overwritten, new))
        self.latest = int(new[-1])
        return len(new)

    @property
    def earliest(self) -> int | None:
        """ns, of what is not written yet"""
        return int(self._stamps[0]) if len(self._stamps) else None

    def take(self, before_ns: int, utc_offset_ns: int) -> list[Block]:
        """Messages of all records that belong before ``before_ns``."""
        count = int(np.searchsorted(self._stamps, before_ns))
        if not count:
            return []
        before = self.reader.position
        stamps, payload = self.reader.drain(count)
        self._stamps = self._stamps[self.reader.position - before :]
        return self.encode(stamps + utc_offset_ns, self.reader.positions, payload)


class Recorder:
    """Records every ring of a directory, also those that appear later."""

    def __init__(
        self,
        ring_dir: Path,
        out: Path,
        recording: Recording,
        metadata: dict[str, str],
        attachments: dict[str, bytes],
        utc_offset_ns: int,
        watch: Watch | None = None,
        scene: Scene | None = None,
    ) -> None:
        """``out`` is written anew, unless an earlier recorder of the same rings wrote it: then, as
        for every further file, the next free name beside it. ``metadata`` becomes the record
        "tonus"; with a ``scene`` viewers get their messages."""
        self._ring_dir, self._out = ring_dir, out
        self._recording = recording
        self._chunk_ns = recording.chunk_ms * 1_000_000
        self._utc_offset_ns = utc_offset_ns
        self._watch = watch
        self._metadata, self._attachments, self._scene = metadata, attachments, scene
        self._sources: dict[str, _Source] = {}
        self._left_out: set[str] = set()
        self._notes: list[tuple[int, NDArray[np.void]]] = []
        self._next_chunk = 0
        self._began: int | None = None
        """number of the file's first chunk"""
        self._lost: dict[str, int] = {}
        """by readers that were closed"""
        self._told: dict[str, int] = {}
        """of the lost, what earlier files tell of"""
        self.stopped = ""
        """why nothing is being recorded, in words; empty while something is"""
        self.files: list[Path] = []
        """every file that this recorder began, in order"""
        self._segment: Segment | None = None
        readers = self._discover()
        again = any(reader.cursor for _, reader in readers)
        try:
            self._segment = self._next_segment(next_name(out) if again else out)
        except OSError as error:
            for _, reader in readers:
                reader.close()
            self._stop(error)
            return
        self._add(readers)
        if again:
            self._look()
            text = f"what is not in an earlier file is in {self.path.name}"
            self.event(Level.WARNING, "recorder_restarted", "recorder", text)

    @property
    def path(self) -> Path:
        """The file being written, or the last one; before the first, where it will be."""
        return self.files[-1] if self.files else self._out

    @property
    def lost(self) -> dict[str, int]:
        """Records that a ring overwrote before they were read, by the ring's name."""
        lost = dict(self._lost)
        for name, source in self._sources.items():
            lost[name] = lost.get(name, 0) + source.reader.lost
        return lost

    def event(self, level: Level, name: str, where: str = "", text: str = "") -> None:
        """Note something about the recording itself, stamped with the latest record's time."""
        record = np.zeros(1, EVENT)
        record["level"], record["name"] = level, name.encode()
        record["where"], record["text"] = where.encode(), text.encode()
        self._notes.append((self._latest() or 0, record))

    def drain(self) -> int:
        """Note all that is new and write the chunks that are complete; gives how many records
        were new."""
        if self.stopped and not self._resume():
            return 0
        try:
            return self._drain()
        except OSError as error:
            self._stop(error)
            return 0

    def finish(self) -> None:
        """Record what is left and make the file whole. The rings' files stay."""
        if self.stopped and not self._resume():
            return
        try:
            self._drain()
            earliest = self._earliest()
            while earliest is not None:
                self._write_chunk(max(earliest // self._chunk_ns, self._next_chunk) + 1)
                earliest = self._earliest()
            for name, count in self.lost.items():
                if count:
                    text = f"{count} records were overwritten"
                    self.event(Level.ERROR, "records_lost", name, text)
            self._close_segment()
        except OSError as error:
            self._stop(error)
            return
        for source in self._sources.values():
            source.reader.close()

    def _drain(self) -> int:
        self._add(self._discover())
        new = self._look()
        self._write_complete()
        return new

    def _look(self) -> int:
        """Take note of what is new in every ring; gives how many records."""
        new = 0
        for name, source in self._sources.items():
            count = source.look()
            new += count
            if count and self._watch is not None and name == CYCLE_RING:
                self._show(source, self._watch)
        return new

    @property
    def _open_segment(self) -> Segment:
        assert self._segment is not None, "nothing is written while recording is stopped"
        return self._segment

    def _next_segment(self, path: Path) -> Segment:
        """Raises OSError, and leaves no file then."""
        metadata = {**self._metadata, "file": path.name}
        try:
            segment = Segment(path, self._recording, metadata, self._attachments, self._scene)
        except OSError:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            raise
        self.files.append(path)
        return segment

    def _close_segment(self) -> None:
        """Raises OSError."""
        segment = self._open_segment
        segment.file.chunk(self._noted())
        lost = self.lost
        here = {name: str(count - self._told.get(name, 0)) for name, count in lost.items()}
        segment.file.metadata("tonus.recorded", here)
        segment.file.finish()
        self._told = lost

    def _rotate(self) -> None:
        """Go on in another file. Raises OSError."""
        self._close_segment()
        self._segment = None
        self._segment = segment = self._next_segment(next_name(self._out, self.files))
        self._began = None
        for name, source in self._sources.items():
            source.encode = segment.encoder(name, source.reader.meta)
        keep = self._recording.keep_files
        for old in self.files[:-keep] if keep else ():
            if old.exists():
                old.unlink()
                text = f"deleted: {keep} files are kept (recording.keep_files)"
                self.event(Level.WARNING, "log_deleted", old.name, text)

    @property
    def _is_full(self) -> bool:
        size, length = self._recording.rotate_mb * _MEGABYTE, self._recording.rotate_s * 1e9
        chunks = 0 if self._began is None else self._next_chunk - self._began
        return bool(
            (size and self._open_segment.file.size >= size)
            or (length and chunks * self._chunk_ns >= length)
        )

    def _stop(self, error: OSError) -> None:
        """Close the file where it is whole; the rings keep what comes, as long as they can."""
        self.stopped = f"{self.path.parent}: {(error.strerror or 'cannot be written').lower()}"
        text = f"{self.stopped}; control goes on, make room and recording goes on too"
        self.event(Level.ERROR, "recording_stopped", "recorder", text)
        if self._segment is not None:
            self._segment.file.abandon()
            self._segment = None
        self._lost = self.lost
        for source in self._sources.values():
            source.reader.close()
        self._sources = {}

    def _resume(self) -> bool:
        """Begin another file, where the disk has room for one."""
        room = self._free_bytes()
        if room < _ROOM + self._recording.keep_free_mb * _MEGABYTE:
            return False
        try:
            self._segment = self._next_segment(next_name(self._out, self.files))
        except OSError:
            return False
        readers = self._discover()
        missing = sum(
            max(0, reader.published - reader.capacity - reader.cursor)
            for name, reader in readers
            if name == CYCLE_RING
        )
        self.stopped = ""
        self._add(readers)
        self._look()
        self._began = None
        text = f"in {self.path.name}; {missing} cycles are missing"
        self.event(Level.WARNING, "recording_resumed", "recorder", text)
        return True

    def _free_bytes(self) -> int:
        return shutil.disk_usage(self._out.parent).free

    def _discover(self) -> list[tuple[str, RingReader]]:
        if not self._ring_dir.is_dir():
            return []
        # In a sixth of the time that a pattern takes.
        names = sorted(each.name for each in self._ring_dir.iterdir() if each.suffix == ".ring")
        return [
            (name, RingReader.open(self._ring_dir / name))
            for name in names
            if name not in self._sources and name not in self._left_out
        ]

    def _add(self, readers: list[tuple[str, RingReader]]) -> None:
        for name, reader in readers:
            if reader.meta.get("kind") == "frames" and not self._recording.raw_frames:
                reader.close()
                self._left_out.add(name)
            else:
                encode = self._open_segment.encoder(name, reader.meta)
                self._sources[name] = _Source(reader, encode)

    def _show(self, source: _Source, watch: Watch) -> None:
        newest = source.reader.newest()
        if newest is not None:
            stamp, payload = newest
            watch(np.frombuffer(payload, cycle_dtype(source.reader.meta))[0], stamp)

    def _latest(self) -> int | None:
        stamps = [source.latest for source in self._sources.values()]
        return max((stamp for stamp in stamps if stamp is not None), default=None)

    def _earliest(self) -> int | None:
        stamps = [source.earliest for source in self._sources.values()]
        return min((stamp for stamp in stamps if stamp is not None), default=None)

    def _write_complete(self) -> None:
        latest, earliest = self._latest(), self._earliest()
        while latest is not None and earliest is not None:
            # What arrives later than a chunk's time goes with the next one.
            chunk = max(earliest // self._chunk_ns, self._next_chunk)
            if latest // self._chunk_ns < chunk + 2:
                return
            self._write_chunk(chunk + 1)
            earliest = self._earliest()

    def _write_chunk(self, end: int) -> None:
        """Write what is stamped before the start of chunk number ``end``. Raises OSError."""
        if self._free_bytes() < self._recording.keep_free_mb * _MEGABYTE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self._is_full:
            self._rotate()
        if self._began is None:
            self._began = end - 1
        self._next_chunk = end
        before_ns = end * self._chunk_ns
        blocks: list[Block] = []
        for name in sorted(self._sources):
            blocks += self._sources[name].take(before_ns, self._utc_offset_ns)
        blocks += self._noted()
        self._open_segment.file.chunk(blocks)
        for source in self._sources.values():
            source.reader.commit()

    def _noted(self) -> list[Block]:
        blocks: list[Block] = []
        for index, (stamp, record) in enumerate(self._notes):
            body = record.view(np.uint8).reshape(1, EVENT.itemsize)
            time = np.array([stamp + self._utc_offset_ns])
            blocks += self._open_segment.events(time, np.array([index]), body)
        self._notes = []
        return blocks
