"""A log written once more with something changed, every checksum in order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tonus.runtime.recording.mcap_file import Block, McapFile
from tonus.tools.log.chunks import content, runs, scan
from tonus.tools.log.schema import body_dtype

Edit = Callable[[str, np.ndarray, np.ndarray], np.ndarray]
"""Receives a topic, its messages of one chunk, to be changed in place, and their sequence numbers;
returns a mask of those to keep."""


def keep_all(_topic: str, rows: np.ndarray, _sequence: np.ndarray) -> np.ndarray:
    return np.ones(len(rows), bool)


def altered(
    source: Path,
    out: Path,
    edit: Edit = keep_all,
    *,
    attachments: dict[str, bytes] | None = None,
    renamed: tuple[str, str] = ("", ""),
) -> Path:
    """``renamed``: a field's name in every schema, and another of the same length."""
    framing = scan(source)
    file = McapFile(out, "zstd")
    for name, values in framing.metadata.items():
        file.metadata(name, values)
    for name, data in {**framing.attachments, **(attachments or {})}.items():
        file.attach(name, data, "application/yaml")
    channels = {}
    for number, channel in framing.channels.items():
        schema = framing.schemas[channel.schema_id]
        text = schema.data.decode().replace(*renamed) if renamed[0] else schema.data.decode()
        channels[number] = file.channel(channel.topic, schema.name, text)
    for place in framing.chunks:
        data = content(source, place)
        assert data is not None
        blocks = []
        for run in runs(data, framing):
            channel = framing.channels[run.channel]
            schema = framing.schemas[channel.schema_id]
            body = run.data[:, 4:].copy()
            dtype = body_dtype(schema.name, schema.data.decode(), body.shape[1])
            rows = body if dtype is None else body.view(dtype)[:, 0]
            keep = edit(channel.topic, rows, run.sequence)
            blocks.append(
                Block(channels[run.channel], run.log_time[keep], run.sequence[keep], body[keep])
            )
        file.chunk(blocks)
    file.finish()
    return out
