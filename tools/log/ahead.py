"""Chunks unpacked ahead of their reader: decompression and checksums run beside it, since both let
go of the interpreter's lock."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from tonus.tools.log.chunks import ChunkPlace, content

_WORKERS = 2
_AHEAD = 4
"""chunks: enough that nobody waits, and little memory"""
_AHEAD_BYTES = 1 << 26
"""unpacked ahead, besides the one that is due"""


def contents(file: Path, places: Sequence[ChunkPlace]) -> Iterator[tuple[ChunkPlace, bytes | None]]:
    """Each place with what `content` gives for it, in order."""
    if len(places) <= 1:
        for place in places:
            yield place, content(file, place)
        return
    pool = ThreadPoolExecutor(_WORKERS)
    try:
        coming: deque[tuple[ChunkPlace, Future[bytes | None]]] = deque()
        ahead = 0
        for place in places:
            coming.append((place, pool.submit(content, file, place)))
            ahead += place.uncompressed_size
            while len(coming) > _AHEAD or (coming and ahead > _AHEAD_BYTES):
                due, found = coming.popleft()
                ahead -= due.uncompressed_size
                yield due, found.result()
        while coming:
            due, found = coming.popleft()
            yield due, found.result()
    finally:
        pool.shutdown(cancel_futures=True)
