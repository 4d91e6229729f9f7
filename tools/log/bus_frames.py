"""Recorded bus frames as .asc or .blf, for the tools that read traces of CAN."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import can
import numpy as np
from can.io import ASCWriter, BLFWriter

from tonus.tools.log.decode import Column
from tonus.tools.log.log import Log

BUS = "/can/"
_NS = 1e-9
_SECOND = 1_000_000_000


def write_frames(log: Log, topics: Sequence[str], path: Path, kind: str) -> None:
    """All buses into one file; channel numbers count the topics."""
    # Both formats keep the beginning to a millisecond only, and frames relative to it.
    begin = log.start_ns // _SECOND
    writer: ASCWriter | BLFWriter
    if kind == "blf":
        writer = BLFWriter(path)
        writer.start_timestamp = float(begin)
    else:
        writer = ASCWriter(path)
        writer.log_event("Start of log", float(begin))
    with writer:
        for batch in log.batches(topics):
            for message in _messages(batch, topics):
                writer.on_message_received(message)


def _messages(batch: dict[str, Column], topics: Sequence[str]) -> Iterator[can.Message]:
    """Frames of a batch in the order in which they were on the buses."""
    parts = [(number, batch[topic]) for number, topic in enumerate(topics)]
    usable = [(n, c) for n, c in parts if c.messages.dtype.names is not None and len(c.times)]
    if not usable:
        return
    number = np.concatenate([np.full(len(c.times), n) for n, c in usable])
    row = np.concatenate([np.arange(len(c.times)) for _, c in usable])
    times = np.concatenate([c.times for _, c in usable])
    sequence = np.concatenate([c.sequence for _, c in usable])
    tables = {n: c.messages.tolist() for n, c in usable}
    stamps = (times * _NS).tolist()
    for index in np.lexsort((sequence, times)).tolist():
        _, _, identifier, remote, extended, error, dlc, data = tables[int(number[index])][
            int(row[index])
        ]
        yield can.Message(
            timestamp=stamps[index],
            arbitration_id=identifier,
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=error,
            channel=int(number[index]),
            dlc=dlc,
            data=None if remote else bytes(data[:dlc]),
        )
