"""One file of a recording: what it announces, and who encodes what into it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Recording
from tonus.runtime.recording.mcap_file import Block, McapFile
from tonus.runtime.recording.messages import Encoder, EventEncoder, encoder
from tonus.runtime.recording.ring import Meta
from tonus.runtime.recording.viewer import Scene, ViewerEncoder
from tonus.runtime.topics import from_json, record_dtype

CYCLE_RING = "cycle.ring"
"""the ring of the cycle records, which viewers' messages are made of"""

_MEDIA_TYPES = {
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".txt": "text/plain",
}


class Segment:
    """Complete in itself: metadata, attachments and topics stand in every file."""

    def __init__(
        self,
        path: Path,
        recording: Recording,
        metadata: dict[str, str],
        attachments: dict[str, bytes],
        scene: Scene | None,
    ) -> None:
        """Raises OSError."""
        self.file = McapFile(path, recording.compression)
        self.file.metadata("tonus", metadata)
        for name in sorted(attachments):
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self.file.attach(name, attachments[name], media_type)
        self.events = EventEncoder(self.file)
        self._scene = scene

    def encoder(self, ring: str, meta: Meta) -> Encoder:
        """For the records of a ring; announces their topics."""
        plain = encoder(self.file, self.events, meta)
        if ring != CYCLE_RING or self._scene is None:
            return plain
        return _Shown(plain, ViewerEncoder(self.file, self._scene), cycle_dtype(meta))


class _Shown:
    """Cycle records as they are, and as viewers like them."""

    def __init__(self, plain: Encoder, viewer: ViewerEncoder, dtype: np.dtype[np.void]) -> None:
        self._plain, self._viewer, self._dtype = plain, viewer, dtype

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        cycles = np.ascontiguousarray(payload).view(self._dtype)[:, 0]
        return [
            *self._plain(log_time, position, payload),
            *self._viewer(log_time, cycles),
        ]


def cycle_dtype(meta: Meta) -> np.dtype[np.void]:
    """Of a ring's records."""
    return record_dtype(from_json(meta["topics"]))


def next_name(path: Path, files: Sequence[Path] = ()) -> Path:
    """``run.mcap`` or, after ``files`` of this run and where a name is taken, ``run.2.mcap`` and so
    on; a name is not used again when its file was deleted."""
    number = len(files)
    while True:
        number += 1
        free = path if number == 1 else path.with_name(f"{path.stem}.{number}{path.suffix}")
        if not free.exists() and free not in files:
            return free
