"""``python -m tests.fuzz``: the long storm. Exit code 1 if something fell."""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path
from time import perf_counter  # noqa: TID251 - how fast a storm is, is the host's own affair

from tests.fuzz.lab import CHECK_EVERY, GrownError, LabUnderFire, shortest, targets
from tests.fuzz.shots import Shot, Storm

_REPORT_EVERY = 20_000
_WEIGH_EVERY = 10_000


def _against_master(seed: int, frames: int) -> int:
    sys.path.insert(0, str(Path(__file__).parents[1]))  # where the tests' own helpers lie
    from tests.property.test_driver_any_frames import fuzz_master

    try:
        events = fuzz_master(seed, frames)
    except AssertionError as error:
        print(f"FALLEN: {error}")
        return 1
    print(f"standing after {frames} frames; events told: {', '.join(sorted(events))}")
    return 0


def _against_segment(seed: int, frames: int) -> int:
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from tests.fuzz.segment import FallenError, fuzz_segment

    print(f"seed {seed}, {frames} frames against the EtherCAT segment of 10 slaves")
    try:
        target = fuzz_segment(seed, frames, _REPORT_EVERY)
    except FallenError as error:
        print(f"FALLEN: {error}")
        return 1
    reached = ", ".join(f"{name} {count}" for name, count in sorted(target.reached.items()))
    print(f"standing after {frames} frames, {target.answered} answered; states seen: {reached}")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--against", choices=("lab", "master", "segment"), default="lab")
    options = parser.parse_args()
    if options.against == "segment":
        return _against_segment(options.seed, options.frames)
    if options.against == "master":
        return _against_master(options.seed, options.frames)
    print(f"seed {options.seed}, {options.frames} frames against the lab of 17 devices")
    recent: list[Shot] = []
    number = 0
    shots = Storm(options.seed, targets())
    start = perf_counter()
    with LabUnderFire() as lab:
        try:
            for shot in itertools.islice(shots, options.frames):
                number += 1
                recent.append(shot)
                lab.fire(shot)
                if number % CHECK_EVERY == 0 or number == options.frames:
                    lab.check()
                    recent.clear()
                if number % _WEIGH_EVERY == 0:
                    lab.weigh()
                if number % _REPORT_EVERY == 0:
                    rate = number / (perf_counter() - start)
                    print(f"{number} frames, {rate:.0f}/s, lab at {lab.seconds:.1f} s", flush=True)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
            print(f"FALLEN at frame {number}: {type(error).__name__}: {error}")
            print(f"again: python -m tests.fuzz --seed {options.seed} --frames {number}")
            failure: Exception | None = error
        else:
            failure = None
    if failure is None:
        reached = ", ".join(f"{name} {count}" for name, count in sorted(lab.states.items()))
        print(f"all standing after {number} frames; {lab.refused} refused at full queues")
        print(f"drive states seen: {reached}")
        return 0
    short = [] if isinstance(failure, GrownError) else shortest(recent, type(failure))
    print(f"{len(short)} of the last {len(recent)} frames, on a fresh lab:")
    for shot in short[:40]:
        print(f"  {shot}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
