"""The framing of an MCAP file: what stands where, up to the first damage."""

from __future__ import annotations

import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from tonus.tools.errors import ToolError

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
"""channel, sequence, log and publish time"""
_BROKEN = (struct.error, UnicodeDecodeError, EndOfFile, ValueError, IndexError, KeyError)
_LARGEST_CHUNK = 1 << 28
"""bytes unpacked; a length beyond it is taken for damage and not for memory to be had"""
_EXPANSION, _ALWAYS = 200, 1 << 25
"""times a file's size, and bytes besides, that its chunks may unpack to: far more than any
controller's records, and little enough that a file made to fill memory cannot"""
_CHUNK_HEAD = 9 + 8 + 8 + 8 + 4 + 4 + 4 + 8
"""bytes of a chunk's record before its content, its compression's name included"""
_FOOTER = 9 + 8 + 8 + 4
_DATA_END = 4
RUN = "run.mcap"
"""the log in the folder of a run"""
_SEARCH = 1 << 20
_STEP = 1 << 16
_NOTHING_LOST = "every message is there"


class DamageError(ToolError):
    """What a checksum vouched for is no sequence of records."""


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk's compressed content lies and what it should unpack to."""

    offset: int
    size: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int
    end_ns: int
    bare: bool = False
    """messages that stand in no chunk"""


@dataclass
class Framing:
    """Everything of a file but its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    media_types: dict[str, str] = field(default_factory=dict)
    """of the attachments"""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    library: str = ""
    profile: str = ""
    statistics: Statistics | None = None
    """of the summary, in what is salvaged"""
    cut: ChunkPlace | None = None
    """a chunk that the file's end cuts, as far as it goes"""
    damage: str | None = None
    """what is wrong and where; everything before it was read"""
    resumed: list[int] = field(default_factory=list)
    """bytes at which, behind a damage, the next chunk was found"""
    data_end: int | None = None
    """where the records end that hold data, None if the file ends earlier"""
    data_crc: int = 0
    """of everything before, 0 for not given"""


@dataclass(frozen=True)
class Run:
    """Messages of one channel and one size that stand together in a chunk."""

    channel: int
    rows: NDArray[np.uint8]
    """(n, 9 + length) whole records"""

    @property
    def sequence(self) -> NDArray[np.int64]:
        """(n,)"""
        return self.rows[:, 11:15].view("<u4")[:, 0].astype(np.int64)

    @property
    def log_time(self) -> NDArray[np.int64]:
        """(n,) ns"""
        return self.rows[:, 15:23].view("<i8")[:, 0].astype(np.int64)

    @property
    def data(self) -> NDArray[np.uint8]:
        """(n, size) encoded messages"""
        return self.rows[:, 9 + _MESSAGE.size :]


def scan(path: Path, *, salvage: bool = False) -> Framing:
    """Walk over the records of a file without unpacking its chunks, to its end or to the first
    damage; with ``salvage`` go on at the next chunk that can be found behind it.

    Raises ToolError when there is nothing to read: no file, or no MCAP file.
    """
    try:
        if stat.S_ISFIFO(path.stat().st_mode):
            raise ToolError(f"{path}: is a pipe; a log is read in any order, so name a file")
        if path.is_dir():
            inside = path / RUN
            remedy = inside if inside.is_file() else "a log that `tonus run` wrote"
            raise ToolError(f"{path}: is a directory; name {remedy}")
        with path.open("rb") as file:
            start = file.read(len(MCAP0_MAGIC))
            if start != MCAP0_MAGIC:
                what = "is empty" if not start else "is not an MCAP file"
                raise ToolError(f"{path}: {what}; name a log that `tonus run` wrote")
            scanner = _Scanner(file, path.stat().st_size)
            at: int | None = scanner.walk(len(MCAP0_MAGIC))
            while salvage and at is not None:
                at = scanner.find_chunk(at)
                if at is not None:
                    scanner.framing.resumed.append(at)
                    at = scanner.walk(at)
            scanner.summary()
            scanner.disbelieve()
            return scanner.framing
    except OSError as error:
        raise ToolError(f"{path}: {(error.strerror or 'unreadable').lower()}") from error


class _Scanner:
    """Collects a `Framing` from one file."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.framing = Framing()
        self._file, self._size = file, size
        self._sound = False
        """the summary's own checksum holds"""

    def walk(self, at: int) -> int | None:
        """Take in the records from byte ``at`` on. Returns where a damaged one begins, or None at
        the end of the file."""
        file, framing = self._file, self.framing
        file.seek(at)
        while framing.data_end is None:
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                self._damaged(f"the file ends at byte {self._size} without its summary")
                return None
            opcode, length = _RECORD.unpack(head)
            inside = at + _RECORD.size
            if length > self._size - inside:
                self._damaged(f"the record at byte {at} is cut short")
                if opcode == Opcode.CHUNK:
                    self._keep_cut(inside, length)
                return at + 1
            try:
                self._take(opcode, at, length)
            except _BROKEN as error:
                self._damaged(f"the record at byte {at} is damaged ({error})")
                return at + 1
            at = inside + length
            file.seek(at)
        self._end(at)
        return None

    def _take(self, opcode: int, at: int, length: int) -> None:
        file, framing, inside = self._file, self.framing, at + _RECORD.size
        if opcode == Opcode.DATA_END:
            (framing.data_crc,) = struct.unpack_from("<I", file.read(length))
            framing.data_end = at
        elif opcode == Opcode.CHUNK:
            framing.chunks.append(_chunk_place(file.read(_CHUNK.size + 64), inside, length))
        elif opcode == Opcode.MESSAGE:
            _, _, stamp, _ = _MESSAGE.unpack(file.read(_MESSAGE.size))
            _add_message(framing.chunks, at, _RECORD.size + length, stamp)
        elif not opcode:
            raise ValueError("there is no such record")
        elif opcode != Opcode.MESSAGE_INDEX:
            _keep(framing, opcode, file.read(length))

    def disbelieve(self) -> None:
        """Leave out the chunks from that on with which the file would unpack to more than any log
        does."""
        framing, limit = self.framing, _ALWAYS + _EXPANSION * self._size
        for index, place in enumerate(framing.chunks):
            limit -= place.uncompressed_size
            if limit < 0:
                del framing.chunks[index:]
                text = f"the chunk at byte {place.offset} claims to unpack to more than any log"
                self._damaged(f"{text} of {self._size} bytes does")
                break
        if framing.cut is not None and framing.cut.uncompressed_size > limit:
            framing.cut = None

    def _keep_cut(self, inside: int, length: int) -> None:
        try:
            whole = _chunk_place(self._file.read(_CHUNK.size + 64), inside, length)
        except _BROKEN:
            return
        if whole.offset < self._size:
            self.framing.cut = replace(whole, size=self._size - whole.offset)

    def summary(self) -> None:
        """Schemas, channels and statistics stand there once more."""
        if self.framing.data_end is None or not self._sound:
            return
        at = self.framing.data_end + _RECORD.size + _DATA_END
        while at < self._size:
            self._file.seek(at)
            head = self._file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                return
            opcode, length = _RECORD.unpack(head)
            if length > self._size - at:
                return
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                try:
                    _keep(self.framing, opcode, self._file.read(length))
                except _BROKEN:
                    return
            at += _RECORD.size + length

    def _end(self, at: int) -> None:
        """The summary, from byte ``at`` on: nobody here needs it, but others do."""
        self._file.seek(at)
        summary = self._file.read()
        end = len(summary) - len(MCAP0_MAGIC) - _FOOTER
        if end < 0 or summary[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC:
            self._damaged(f"the summary is cut short at byte {self._size}; {_NOTHING_LOST}")
            return
        (crc,) = struct.unpack_from("<I", summary, len(summary) - len(MCAP0_MAGIC) - 4)
        self._sound = crc == zlib.crc32(summary[: -len(MCAP0_MAGIC) - 4])
        if crc and not self._sound:
            self._damaged(f"the summary at byte {at} fails its checksum; {_NOTHING_LOST}")

    def find_chunk(self, at: int) -> int | None:
        """Where, from byte ``at`` on, something stands that can only be a chunk."""
        while at < self._size:
            self._file.seek(at)
            block = np.frombuffer(self._file.read(_SEARCH + _CHUNK_HEAD), np.uint8)
            for offset in np.flatnonzero(block[:_SEARCH] == Opcode.CHUNK).tolist():
                head = block[offset : offset + _CHUNK_HEAD].tobytes()
                if len(head) < _RECORD.size:
                    break
                _, length = _RECORD.unpack_from(head)
                if length > self._size - at - offset:
                    continue
                try:
                    _chunk_place(head[_RECORD.size :], 0, length)
                except _BROKEN:
                    continue
                return int(at + offset)
            at += _SEARCH
        return None

    def _damaged(self, text: str) -> None:
        """The first damage is the one to name."""
        self.framing.damage = self.framing.damage or text


def _add_message(chunks: list[ChunkPlace], at: int, size: int, stamp: int) -> None:
    """A message outside a chunk: with those before it, it makes one that is not packed."""
    last = chunks[-1] if chunks else None
    if last is None or last.offset + last.size != at or not last.bare or last.size > _SEARCH:
        chunks.append(ChunkPlace(at, size, "", size, 0, stamp, stamp, bare=True))
        return
    size += last.size
    start, end = min(last.start_ns, stamp), max(last.end_ns, stamp)
    chunks[-1] = ChunkPlace(last.offset, size, "", size, 0, start, end, bare=True)


def data_is_whole(path: Path, framing: Framing) -> bool:
    """Whether everything before the summary is as it was written, as far as a checksum says."""
    if framing.data_end is None or not framing.data_crc:
        return framing.data_end is not None
    crc, left = 0, framing.data_end
    with path.open("rb") as file:
        while left:
            block = file.read(min(left, _SEARCH))
            if not block:
                return False
            crc = zlib.crc32(block, crc)
            left -= len(block)
    return crc == framing.data_crc


def content(file: Path, place: ChunkPlace) -> bytes | None:
    """The records of a chunk, or None if it does not unpack to what it should."""
    data = unpack(read(file, place), place)
    if data is None or len(data) != place.uncompressed_size:
        return None
    if place.crc and zlib.crc32(data) != place.crc:
        return None
    return data


def read(file: Path, place: ChunkPlace) -> bytes:
    """A chunk as it is packed."""
    with file.open("rb") as stream:
        stream.seek(place.offset)
        return stream.read(place.size)


def unpack(packed: bytes, place: ChunkPlace) -> bytes | None:
    """What a chunk's bytes unpack to, or the beginning of it where they are damaged, and never more
    than the chunk should hold; None where nothing can be said."""
    if place.compression == "":
        return packed
    try:
        if place.compression == "zstd":
            stated = zstandard.frame_content_size(packed)
            if stated == place.uncompressed_size:
                return zstandard.ZstdDecompressor().decompress(packed)
        else:
            stated = lz4.frame.get_frame_info(packed)["content_size"]
            if stated == place.uncompressed_size:
                whole: bytes = lz4.frame.decompress(packed)
                return whole
    except (zstandard.ZstdError, RuntimeError):
        pass  # it may still have a beginning
    return _beginning(packed, place)


def _beginning(packed: bytes, place: ChunkPlace) -> bytes:
    """Unpack a step at a time, up to the damage and not beyond what the chunk should hold."""
    data = bytearray()
    try:
        for part in _steps(packed, place.compression):
            data += part
            if len(data) > place.uncompressed_size:
                break
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass  # the caller sees that it is short
    return bytes(data)


def _steps(packed: bytes, compression: str) -> Iterator[bytes]:
    if compression == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(packed)
        while part := reader.read(_STEP):
            yield part
        return
    unpacker = lz4.frame.LZ4FrameDecompressor()
    given = packed
    while not unpacker.eof and (part := unpacker.decompress(given, _STEP)):
        given = b""
        yield part


def runs(data: bytes, framing: Framing) -> Iterator[Run]:
    """The messages of a chunk, in as few runs as they stand in. Schemas and channels met on the way
    go to ``framing``."""
    buffer = np.frombuffer(data, np.uint8)
    at, end = 0, len(data)
    while at + _RECORD.size <= end:
        opcode, length = _RECORD.unpack_from(data, at)
        stride = _RECORD.size + length
        if at + stride > end:
            return
        if opcode != Opcode.MESSAGE:
            try:
                _keep(framing, opcode, data[at + _RECORD.size : at + stride])
            except _BROKEN as error:
                raise DamageError(f"a record inside a chunk is damaged ({error})") from error
            at += stride
            continue
        if length < _MESSAGE.size:
            raise DamageError("a message inside a chunk is shorter than its head")
        count = _alike(buffer, at, stride)
        rows = buffer[at : at + count * stride].reshape(count, stride)
        yield Run(int.from_bytes(data[at + 9 : at + 11], "little"), rows)
        at += count * stride


def _alike(buffer: NDArray[np.uint8], at: int, stride: int) -> int:
    """How many records from ``at`` on have the same opcode, length and channel."""
    most = (len(buffer) - at) // stride
    rows = buffer[at : at + most * stride].reshape(most, stride)
    # Bytes 0 to 10, as two words that overlap.
    first, second = (rows[:, start : start + 8].view("<u8")[:, 0] for start in (0, 3))
    count, step = 1, 512
    while count < most:
        same = first[count : count + step] == first[0]
        same &= second[count : count + step] == second[0]
        unlike = int(same.argmin())
        if not same[unlike]:
            return count + unlike
        count += len(same)
        step *= 4
    return count


def _chunk_place(head: bytes, at: int, length: int) -> ChunkPlace:
    start, end, size, crc, name_length = _CHUNK.unpack_from(head)
    name = head[_CHUNK.size : _CHUNK.size + name_length].decode()
    body = _CHUNK.size + name_length + 8
    (packed,) = struct.unpack_from("<Q", head, body - 8)
    if packed != length - body or name not in ("zstd", "lz4", ""):
        raise ValueError("a chunk's header does not fit its length")
    if size > _LARGEST_CHUNK or (not name and size != packed):
        raise ValueError(f"a chunk that claims {size} bytes")
    return ChunkPlace(at + body, packed, name, size, crc, start, end)


def _keep(framing: Framing, opcode: int, data: bytes) -> None:
    stream = ReadDataStream(BytesIO(data))
    if opcode == Opcode.HEADER:
        header = Header.read(stream)
        framing.library, framing.profile = header.library, header.profile
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        framing.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        framing.channels[channel.id] = channel
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        if zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
            raise ValueError(f"attachment {attachment.name} fails its checksum")
        framing.attachments[attachment.name] = attachment.data
        framing.media_types[attachment.name] = attachment.media_type
    elif opcode == Opcode.STATISTICS:
        framing.statistics = Statistics.read(stream)
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        framing.metadata[metadata.name] = metadata.metadata
