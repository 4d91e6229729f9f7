"""``python -m tests.fuzz.storm_of_logs``: damaged logs by the hundred; exit code 1 if one fells us.

The log is the newest golden one, a real run of a few ticks round each change of state, so that
every reader has work to do, and little of it.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import numpy as np

from tests.fuzz.logs import DAMAGES, SEGMENTS, read, readers
from tonus.runtime.recording.mcap_file import Block, McapFile
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.tools.log.chunks import content, runs, scan

GOLDEN = Path(__file__).parents[1] / "replay" / "golden"
CHUNKS = 12
_DRAWN = 20
"""every so many reports are drawn too; the others are judged and laid out only"""
_TOLD = 50


def source(folder: Path) -> dict[str, bytes]:
    """The golden log in three segments of four chunks each."""
    (path,) = GOLDEN.glob(f"v{SCHEMA_VERSION}.mcap")
    framing = scan(path)
    found: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for place in framing.chunks:
        data = content(path, place)
        assert data is not None
        for run in runs(data, framing):
            row = (run.log_time.copy(), run.sequence.copy(), run.data[:, 4:].copy())
            found.setdefault(run.channel, []).append(row)
    timing = next(n for n, c in framing.channels.items() if c.topic == "/tonus/timing")
    stamps = np.concatenate([times for times, _, _ in found[timing]])
    edges = [0, *(int(part[0]) for part in np.array_split(stamps, CHUNKS)[1:]), 1 << 62]
    each = CHUNKS // len(SEGMENTS)
    files = {}
    for number, name in enumerate(SEGMENTS):
        file = McapFile(folder / name, "zstd", profile="ros2")
        for key, values in framing.metadata.items():
            file.metadata(key, values)
        for key, data in framing.attachments.items():
            file.attach(key, data, "application/yaml")
        channels = {}
        for key, channel in framing.channels.items():
            schema = framing.schemas[channel.schema_id]
            channels[key] = file.channel(channel.topic, schema.name, schema.data.decode())
        for chunk in range(each * number, each * (number + 1)):
            blocks = []
            for key, rows in found.items():
                for times, sequence, body in rows:
                    of = (times >= edges[chunk]) & (times < edges[chunk + 1])
                    if of.any():
                        blocks.append(Block(channels[key], times[of], sequence[of], body[of]))
            file.chunk(blocks)
        file.finish()
        files[name] = (folder / name).read_bytes()
    return files


def cases(files: dict[str, bytes], seed: int) -> Iterator[tuple[str, dict[str, bytes]]]:
    """What was done, and the files then: one of them damaged, or one missing."""
    rng = random.Random(seed)
    number = 0
    while True:
        damage = DAMAGES[number % len(DAMAGES)]
        hit = rng.choice(SEGMENTS)
        # The first alone, all three, or with one that is not there.
        kept = rng.choice((SEGMENTS[:1], SEGMENTS, SEGMENTS, (SEGMENTS[0], SEGMENTS[2])))
        hit = hit if hit in kept else SEGMENTS[0]
        after = {name: files[name] for name in kept}
        after[hit] = damage(after[hit], rng)
        number += 1
        yield f"{damage.__name__} {hit} of {len(kept)}", after


def storm(
    seed: int, count: int, names: tuple[str, ...], *, drawn: int, told: bool = False
) -> Counter[str]:
    """How the readers ended. Raises AssertionError with the case's number."""
    ends: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        files = source(Path(place))
        chosen = zip(range(count), cases(files, seed), strict=False)
        for number, (what, damaged) in chosen:
            undrawn = patch("tonus.tools.report.page._image", return_value="")
            try:
                with nullcontext() if number % drawn == 0 else undrawn:
                    found = read(damaged, Path(place) / "case", names)
            except AssertionError as fallen:
                raise AssertionError(f"case {number}, {what}: {fallen}") from fallen
            for name, end in found.items():
                ends[f"{name}: {end if end in ('done', 'failed') else 'one line'}"] += 1
            if told and (number + 1) % _TOLD == 0:
                print(f"{number + 1} of {count}", flush=True)
    return ends


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.files} damaged logs")
    try:
        ends = storm(options.seed, options.files, tuple(readers(Path())), drawn=_DRAWN, told=True)
    except AssertionError as fallen:
        print(f"FALLEN: {fallen}")
        return 1
    for end, count in sorted(ends.items()):
        print(f"  {end:<20} {count}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
