"""From rings to an MCAP file: copies what is new, closes a chunk when its stretch of run time is
over, and only then moves the readers' cursors.

Which chunk a record goes to follows from its stamp alone, and a chunk stays open for one more
chunk's time for what arrives late; so the file's bytes do not depend on when or how often `drain`
is called.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from config.schema.control import Recording
from runtime.mcap_file import Block, McapFile
from runtime.messages import Encoder, EventEncoder, RecordEncoder, encoder
from runtime.ring import RingReader
from runtime.taps import EVENT, Level

CYCLE_RING = "cycle.ring"
"""the ring whose records `watch` is shown"""

Watch = Callable[[np.void, int], None]
"""Receives the newest cycle record and its stamp in ns."""

_MEDIA_TYPES = {
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".txt": "text/plain",
}


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
    """Records every ring of a directory, also those that appear later, into one file."""

    def __init__(
        self,
        ring_dir: Path,
        out: Path,
        recording: Recording,
        metadata: dict[str, str],
        attachments: dict[str, bytes],
        utc_offset_ns: int,
        watch: Watch | None = None,
    ) -> None:
        """``out`` is written anew, unless an earlier recorder of the same rings wrote it: then the
        next free name beside it. ``metadata`` becomes the record "tonus"."""
        self._ring_dir = ring_dir
        self._chunk_ns = recording.chunk_ms * 1_000_000
        self._raw_frames = recording.raw_frames
        self._utc_offset_ns = utc_offset_ns
        self._watch = watch
        self._sources: dict[str, _Source] = {}
        self._left_out: set[str] = set()
        self._notes: list[tuple[int, NDArray[np.void]]] = []
        self._next_chunk = 0
        readers = self._discover()
        if any(reader.cursor for _, reader in readers):
            out = _free_name(out)
        self.path = out
        self._file = McapFile(out, recording.compression)
        self._file.metadata("tonus", metadata)
        for name in sorted(attachments):
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._file.attach(name, attachments[name], media_type)
        self._events = EventEncoder(self._file)
        self._add(readers)

    @property
    def lost(self) -> dict[str, int]:
        """Records that a ring overwrote before they were read, by the ring's name."""
        return {name: source.reader.lost for name, source in self._sources.items()}

    def event(self, level: Level, name: str, where: str = "", text: str = "") -> None:
        """Note something about the recording itself, stamped with the latest record's time."""
        record = np.zeros(1, EVENT)
        record["level"], record["name"] = level, name.encode()
        record["where"], record["text"] = where.encode(), text.encode()
        self._notes.append((self._latest() or 0, record))

    def drain(self) -> int:
        """Note all that is new and write the chunks that are complete; gives how many records
        were new."""
        self._add(self._discover())
        new = 0
        for name, source in self._sources.items():
            count = source.look()
            new += count
            if count and self._watch is not None and name == CYCLE_RING:
                self._show(source, self._watch)
        self._write_complete()
        return new

    def finish(self) -> None:
        """Record what is left and make the file whole. The rings' files stay."""
        self.drain()
        earliest = self._earliest()
        while earliest is not None:
            self._write_chunk(max(earliest // self._chunk_ns, self._next_chunk) + 1)
            earliest = self._earliest()
        for name, count in self.lost.items():
            if count:
                self.event(Level.ERROR, "records_lost", name, f"{count} records were overwritten")
        self._file.chunk(self._noted())
        self._file.metadata("tonus.recorded", {name: str(n) for name, n in self.lost.items()})
        self._file.finish()
        for source in self._sources.values():
            source.reader.close()

    def _discover(self) -> list[tuple[str, RingReader]]:
        names = sorted(path.name for path in self._ring_dir.glob("*.ring"))
        return [
            (name, RingReader.open(self._ring_dir / name))
            for name in names
            if name not in self._sources and name not in self._left_out
        ]

    def _add(self, readers: list[tuple[str, RingReader]]) -> None:
        for name, reader in readers:
            if reader.meta.get("kind") == "frames" and not self._raw_frames:
                reader.close()
                self._left_out.add(name)
            else:
                encode = encoder(self._file, self._events, reader.meta)
                self._sources[name] = _Source(reader, encode)

    def _show(self, source: _Source, watch: Watch) -> None:
        newest = source.reader.newest()
        if newest is not None and isinstance(source.encode, RecordEncoder):
            stamp, payload = newest
            watch(np.frombuffer(payload, source.encode.dtype)[0], stamp)

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
        """Write what is stamped before the start of chunk number ``end``."""
        self._next_chunk = end
        before_ns = end * self._chunk_ns
        blocks: list[Block] = []
        for name in sorted(self._sources):
            blocks += self._sources[name].take(before_ns, self._utc_offset_ns)
        self._file.chunk(blocks)
        for source in self._sources.values():
            source.reader.commit()

    def _noted(self) -> list[Block]:
        blocks: list[Block] = []
        for index, (stamp, record) in enumerate(self._notes):
            body = record.view(np.uint8).reshape(1, EVENT.itemsize)
            time = np.array([stamp + self._utc_offset_ns])
            blocks += self._events(time, np.array([index]), body)
        return blocks


def _free_name(path: Path) -> Path:
    """``run.mcap`` or, where that is taken, ``run.2.mcap`` and so on."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}.{number}{path.suffix}")
    return free
