"""The framing of an MCAP file: what stands where, up to the first damage."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from tools.errors import ToolError

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE_HEAD = 2 + 4 + 8 + 8
_BROKEN = (struct.error, UnicodeDecodeError, EndOfFile, ValueError, IndexError)


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


@dataclass
class Framing:
    """Everything of a file but its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    library: str = ""
    damage: str | None = None
    """what is wrong and where; everything before it was read"""


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
        return self.rows[:, 9 + _MESSAGE_HEAD :]


def scan(path: Path) -> Framing:
    """Walk over the records of a file without unpacking its chunks.

    Raises ToolError when there is nothing to read: no file, or no MCAP file.
    """
    try:
        with path.open("rb") as file:
            start = file.read(len(MCAP0_MAGIC))
            size = path.stat().st_size
            if start != MCAP0_MAGIC:
                what = "is empty" if not start else "is not an MCAP file"
                raise ToolError(f"{path}: {what}; name a log that `tonus run` wrote")
            framing = Framing()
            at = len(MCAP0_MAGIC)
            while framing.damage is None:
                head = file.read(_RECORD.size)
                if len(head) < _RECORD.size:
                    framing.damage = f"the file ends at byte {size} without its summary"
                    break
                opcode, length = _RECORD.unpack(head)
                at += _RECORD.size
                if length > size - at:
                    framing.damage = f"the record at byte {at - _RECORD.size} is cut short"
                    break
                if opcode == Opcode.DATA_END:
                    break
                try:
                    if opcode == Opcode.CHUNK:
                        framing.chunks.append(_chunk_place(file.read(_CHUNK.size + 64), at, length))
                    elif opcode != Opcode.MESSAGE_INDEX:
                        _keep(framing, opcode, file.read(length))
                except _BROKEN as error:
                    framing.damage = f"the record at byte {at - _RECORD.size} is damaged ({error})"
                at += length
                file.seek(at)
            return framing
    except OSError as error:
        raise ToolError(f"{path}: {(error.strerror or 'unreadable').lower()}") from error


def content(file: Path, place: ChunkPlace) -> bytes | None:
    """The records of a chunk, or None if it does not unpack to what it should."""
    with file.open("rb") as stream:
        stream.seek(place.offset)
        packed = stream.read(place.size)
    try:
        if place.compression == "zstd":
            data = zstandard.ZstdDecompressor().decompress(
                packed, max_output_size=place.uncompressed_size
            )
        elif place.compression == "lz4":
            data = lz4.frame.decompress(packed)
        else:
            data = packed
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return None
    if len(data) != place.uncompressed_size or (place.crc and zlib.crc32(data) != place.crc):
        return None
    return data


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
            _keep(framing, opcode, data[at + _RECORD.size : at + stride])
            at += stride
            continue
        count = _alike(buffer, at, stride)
        rows = buffer[at : at + count * stride].reshape(count, stride)
        yield Run(int.from_bytes(data[at + 9 : at + 11], "little"), rows)
        at += count * stride


def _alike(buffer: NDArray[np.uint8], at: int, stride: int) -> int:
    """How many records from ``at`` on have the same opcode, length and channel."""
    most = (len(buffer) - at) // stride
    rows = buffer[at : at + most * stride].reshape(most, stride)
    head = rows[0, :11]
    count, step = 1, 64
    while count < most:
        same = (rows[count : count + step, :11] == head).all(axis=1)
        if not same.all():
            return count + int(same.argmin())
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
    if size > 1 << 32:
        raise ValueError("a chunk larger than 4 GiB")
    return ChunkPlace(at + body, packed, name, size, crc, start, end)


def _keep(framing: Framing, opcode: int, data: bytes) -> None:
    stream = ReadDataStream(BytesIO(data))
    if opcode == Opcode.HEADER:
        framing.library = Header.read(stream).library
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
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        framing.metadata[metadata.name] = metadata.metadata
