"""A ten-minute log as arrays, beside the readers that everybody has."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.bench.measure import Figure
from tonus.config import load
from tonus.runtime.recording.mcap_file import Index, McapFile
from tonus.tools.log import open as open_log
from tonus.tools.log.chunks import content, read, runs, scan, unpack
from tonus.tools.log.replay import replay
from tonus.tools.report.page import report
from tonus.tools.run.composer import Order, run

SECONDS = 10.0
OVERRIDES: dict[str, Any] = {}
"""of the configuration: none"""
"""of the run that the long log is made of"""
CYCLES = 600_000
SAMPLE = 100_000
"""messages that the peer decodes; the rest of its time is in proportion"""
REPORT_LIMIT_S = 30.0
PERIOD_NS = 1_000_000


def log() -> list[Figure]:
    """Loading whole: every topic, every message."""
    config, scenario = load("config/direct.yaml", overrides=OVERRIDES)
    scenario = scenario.model_copy(update={"duration": SECONDS})
    with tempfile.TemporaryDirectory() as folder:
        order = Order(config, scenario, Path(folder), 1, True, lambda _: None, live=False)
        short = run(order).log
        path = _long(short, Path(folder) / "long.mcap")
        ours = _seconds(lambda: open_log(path).load())
        unpacked = _seconds(lambda: _unpack(path))
        whole = open_log(path)
        messages = sum(len(whole.times(topic)) for topic in whole.topics)
        peer = _seconds(lambda: _iterate(path)) * messages / SAMPLE
        ticks = len(open_log(short)["/tonus/timing"])
        again = _seconds(lambda: replay(open_log(short)))
        size = path.stat().st_size
        page = _seconds(lambda: report(path, Path(folder) / "report.html", lambda _: None))
    note = f"{CYCLES} cycles, {size / 1e6:.0f} MB, processor time; the peer over {SAMPLE} messages"
    return [
        Figure("load a ten-minute log", ours, "s", "mcap and rosbags", peer, note),
        Figure("load a ten-minute log", ours, "s", "unpacking its chunks", unpacked, "file cached"),
        Figure(
            "report on it", page, "s", "its limit", REPORT_LIMIT_S, "processor time, all threads"
        ),
        Figure("replay a tick", again / ticks * 1e6, "us", note="reading the log included"),
    ]


def _long(short: Path, out: Path) -> Path:
    """The chunks of a run again and again, later each time."""
    framing = scan(short)
    file = McapFile(out, "zstd")
    file.adopt(framing.schemas.values(), framing.channels.values())
    timing = next(n for n, c in framing.channels.items() if c.topic == "/tonus/timing")
    written, lag = 0, 0
    # The last ones are cut off where the run ended.
    places = framing.chunks[:-2]
    for place in itertools.cycle(places):
        if written >= CYCLES:
            break
        data = content(short, place)
        assert data is not None
        parts, indexes, at = [], [], 0
        for part in runs(data, framing):
            rows = part.rows.copy()
            for offset in (15, 23):
                rows[:, offset : offset + 8].view("<u8")[:] += np.uint64(lag)
            if part.channel == timing:
                rows[:, 35:43].view("<u8")[:] += np.uint64(lag // PERIOD_NS)
                written += len(rows)
            offsets = at + rows.shape[1] * np.arange(len(rows))
            indexes.append(Index(part.channel, part.log_time + lag, offsets))
            parts.append(rows.tobytes())
            at += rows.size
        file.records(memoryview(b"".join(parts)), indexes)
        if place is places[-1]:
            lag += place.end_ns + PERIOD_NS - places[0].start_ns
    file.finish()
    return out


def _unpack(path: Path) -> None:
    for place in scan(path).chunks:
        unpack(read(path, place), place)


def _iterate(path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    known: set[str] = set()
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(log_time_order=False)
        for schema, _, message in itertools.islice(messages, SAMPLE):
            assert schema is not None
            if schema.name not in known:
                known.add(schema.name)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            store.deserialize_cdr(message.data, schema.name)


def _seconds(action: Callable[[], object]) -> float:
    """Processor time of all threads: a machine that others use too does not change it much."""
    start = os.times()
    action()
    end = os.times()
    return end.user - start.user + end.system - start.system
