"""Writes one MCAP file from whole blocks of messages.

Framing comes from the `mcap` package's records; the content of a chunk is laid out by numpy, since
the messages of a block are all of one size. A block's messages stand together in their chunk, which
compresses better than interleaving and decodes as one strided array. Everything a reader needs
stands before the first message, so a file that was cut short still says what it is. The same calls
give the same bytes: nothing here reads a clock.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

CDR_HEADER = b"\x00\x01\x00\x00"
"""encapsulation: plain CDR, little-endian"""

_HEAD = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]
_HEAD_LENGTH = 2 + 4 + 8 + 8
_CHUNK_HEAD = struct.Struct("<BQQQQII")
"""opcode, length, start, end, uncompressed size and CRC, length of the compression's name"""
_INDEX_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4")])
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


@dataclass(frozen=True)
class Index:
    """Where messages of one channel stand in the content of a chunk."""

    channel: int
    log_time: NDArray[np.int64]
    """(n,) ns"""
    offset: NDArray[np.int64]
    """(n,) of their records, from the content's start"""


class Announces(Protocol):
    """Where messages go to: a file, or a server for viewers."""

    def channel(self, topic: str, message: str, definition: str) -> int:
        """Announce a topic of CDR messages with their ROS 2 definition; gives the channel's id."""


@dataclass(frozen=True)
class Block:
    """Messages of one channel in order of time, all of one size."""

    channel: int
    log_time: NDArray[np.int64]
    """(n,) ns"""
    sequence: NDArray[np.int64]
    """(n,), taken modulo 2^32"""
    body: NDArray[np.uint8]
    """(n, size), CDR body without its encapsulation header"""

    @property
    def dtype(self) -> np.dtype[np.void]:
        """One message record, as it stands in the file."""
        data = [("cdr", "u1", (len(CDR_HEADER),)), ("body", "u1", (self.body.shape[1],))]
        return np.dtype(_HEAD + data)

    def encode(self, records: NDArray[np.void]) -> None:
        """Fill ``records`` (n,) of `dtype`."""
        records["opcode"] = Opcode.MESSAGE
        records["length"] = _HEAD_LENGTH + len(CDR_HEADER) + self.body.shape[1]
        records["channel"] = self.channel
        records["sequence"] = self.sequence & 0xFFFFFFFF
        records["log_time"] = self.log_time
        records["publish_time"] = self.log_time
        records["cdr"] = np.frombuffer(CDR_HEADER, np.uint8)
        records["body"] = self.body


class McapFile:
    """An MCAP file in the making; `finish` makes it whole."""

    def __init__(
        self, path: Path, compression: str, *, profile: str = "ros2", library: str = "tonus"
    ) -> None:
        """``compression``: zstd, lz4 or none."""
        self.path = path
        self._name, self._compress = _compressor(compression)
        # Not buffered, so that nothing of a chunk that failed can be written later.
        self._file = path.open("wb", buffering=0)
        self._offset = 0
        self._crc = 0
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[int, Channel] = {}
        # Encoded at once: a long run has thousands, and as objects they are ten times as large.
        self._chunk_indexes = bytearray()
        self._chunk_count = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._first: int | None = None
        self._last = 0
        self._write(MCAP0_MAGIC)
        self._record(Header(profile=profile, library=library))

    def channel(self, topic: str, message: str, definition: str) -> int:
        """Announce a topic of CDR messages with their ROS 2 definition; gives the channel's id."""
        schema = self._schemas.get(message)
        if schema is None:
            schema = Schema(
                id=len(self._schemas) + 1,
                name=message,
                encoding="ros2msg",
                data=definition.encode(),
            )
            self._schemas[message] = schema
            self._record(schema)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=schema.id,
            metadata={"offered_qos_profiles": ""},
        )
        self._channels[channel.id] = channel
        self._counts[channel.id] = 0
        self._record(channel)
        return channel.id

    def adopt(self, schemas: Iterable[Schema], channels: Iterable[Channel]) -> None:
        """Announce what another file announced, under the numbers it has there."""
        for schema in schemas:
            self._schemas[f"{schema.name} {schema.id}"] = schema
            self._record(schema)
        for channel in channels:
            self._channels[channel.id] = channel
            self._counts[channel.id] = 0
            self._record(channel)

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        offset = self._offset
        record = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        length = self._record(record)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        offset = self._offset
        length = self._record(Metadata(name=name, metadata=dict(sorted(values.items()))))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def chunk(self, blocks: Sequence[Block]) -> None:
        """Write one chunk with its message indexes and hand it to the operating system: from here
        on it survives this process, though not a loss of power."""
        blocks = [block for block in blocks if len(block.log_time)]
        if not blocks:
            return
        groups: dict[int, list[Block]] = {}
        for each in blocks:
            groups.setdefault(each.channel, []).append(each)
        sizes = [(block.dtype, len(block.log_time)) for block in blocks]
        content = np.empty(sum(dtype.itemsize * count for dtype, count in sizes), np.uint8)
        indexes: list[Index] = []
        offset = 0
        for channel, group in groups.items():
            for block in group:
                dtype, count = block.dtype, len(block.log_time)
                block.encode(np.frombuffer(content.data, dtype, count, offset))
                places = offset + dtype.itemsize * np.arange(count)
                indexes.append(Index(channel, block.log_time, places))
                offset += dtype.itemsize * count
        self.records(content.data, indexes)

    def records(self, content: memoryview, places: Sequence[Index]) -> None:
        """The same from records that are encoded already; ``places`` names all its messages."""
        parts: dict[int, list[NDArray[np.void]]] = {}
        for place in places:
            entry = np.empty(len(place.log_time), _INDEX_ENTRY)
            entry["log_time"], entry["offset"] = place.log_time, place.offset
            parts.setdefault(place.channel, []).append(entry)
        indexes = {
            channel: _message_index(channel, np.concatenate(part))
            for channel, part in parts.items()
        }
        start = min(int(place.log_time.min()) for place in places)
        end = max(int(place.log_time.max()) for place in places)
        data = self._compress(content)
        chunk_at = self._offset
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK,
            _CHUNK_HEAD.size - 9 + len(self._name) + 8 + len(data),
            start,
            end,
            content.nbytes,
            zlib.crc32(content),
            len(self._name),
        )
        head += self._name.encode() + len(data).to_bytes(8, "little")
        length = len(head) + len(data)
        offsets: dict[int, int] = {}
        index_at = at = self._offset + length
        for channel, index in indexes.items():
            offsets[channel] = at
            at += len(index)
        self._write(b"".join([head, data, *indexes.values()]))
        # Only now, so that a chunk that could not be written is not in the summary either.
        for place in places:
            self._counts[place.channel] += len(place.log_time)
        self._first = start if self._first is None else min(self._first, start)
        self._last = max(self._last, end)
        self._chunk_count += 1
        self._chunk_indexes += _bytes_of(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=chunk_at,
                compression=self._name,
                compressed_size=len(data),
                message_end_time=end,
                message_index_length=self._offset - index_at,
                message_index_offsets=offsets,
                message_start_time=start,
                uncompressed_size=content.nbytes,
            )
        )

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._offset

    def abandon(self) -> None:
        """After a write that failed: cut the file back to where it was whole and finish it there,
        without its summary if there is no room for one either."""
        whole = self._offset
        self._file.truncate(whole)
        self._file.seek(whole)
        try:
            self.finish()
        except OSError:
            self._file.truncate(whole)
            self._file.close()

    def finish(self) -> None:
        """Write the summary and close the file."""
        self._record(DataEnd(data_section_crc=self._crc))
        start = self._offset
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=self._last,
            message_start_time=self._first or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        content = bytearray()
        offsets = b""
        for opcode, group in (
            (Opcode.SCHEMA, b"".join(map(_bytes_of, self._schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(_bytes_of, self._channels.values()))),
            (Opcode.STATISTICS, _bytes_of(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, b"".join(map(_bytes_of, self._attachments))),
            (Opcode.METADATA_INDEX, b"".join(map(_bytes_of, self._metadata))),
        ):
            if group:
                offsets += _bytes_of(SummaryOffset(opcode, start + len(content), len(group)))
            content += group
        offsets_at = start + len(content)
        content += offsets
        # The CRC covers the footer up to itself, so it is made with a zero in its place first.
        footer = _bytes_of(Footer(start, offsets_at, 0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(content))
        self._write(content + footer[:-4] + crc.to_bytes(4, "little") + MCAP0_MAGIC)
        self._file.close()

    def _record(self, record: McapRecord) -> int:
        return self._write(_bytes_of(record))

    def _write(self, data: bytes | bytearray) -> int:
        left = memoryview(data)
        while left:
            left = left[self._file.write(left) :]
        self._crc = zlib.crc32(data, self._crc)
        self._offset += len(data)
        return len(data)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap annotates only in part
    return data


def _message_index(channel: int, entries: NDArray[np.void]) -> bytes:
    """A MessageIndex record; readers may rely on its entries being in order of time."""
    entries = entries[np.argsort(entries["log_time"], kind="stable")]
    head = np.zeros(1, _INDEX_HEAD)
    head["opcode"] = Opcode.MESSAGE_INDEX
    head["length"] = 2 + 4 + entries.nbytes
    head["channel"] = channel
    head["size"] = entries.nbytes
    return head.tobytes() + entries.tobytes()


def _compressor(name: str) -> tuple[str, Callable[[memoryview], bytes]]:
    """MCAP's name of a compression, and its function at the fastest level."""
    if name == "zstd":
        return "zstd", zstandard.ZstdCompressor(level=1).compress
    if name == "lz4":
        return "lz4", _lz4
    if name == "none":
        return "", bytes
    raise ValueError(f"unknown compression {name}")


def _lz4(data: memoryview) -> bytes:
    compressed: bytes = lz4.frame.compress(data)
    return compressed
