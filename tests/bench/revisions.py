"""This revision against an earlier one, through commands that both have.

    python -m tests.bench.revisions BASE [--rounds N] [--realtime S]
    python -m tests.bench.revisions BASE --misses MINUTES

In alternation on one host: what a tick of a virtual run costs the processor, from two lengths of
the same run so that starting costs nothing; its speed against real time; and ticks in real time.
With --misses, a minute at a time: ticks that each missed of its own, beside whole periods by which
a bare thread exceeded its own with a fixed computation of the cycle's length.
BASE is cloned, and its environment made, in out/revisions, where it is kept for the next time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.measure import fixed_loop_ms
from tests.bench.realtime import fixed_computation

CONFIGS = ("can", "direct", "ethercat")
_SHORT_S, _LONG_S = 1.0, 6.0
_REALTIME_S = 10.0
_MINUTE_S = 60.0
_HOLD = ("--scenario", "hold", "--duration", str(_MINUTE_S))
_PERIOD_US = 1e3
_STEPS = 7_500
"""of the fixed computation at first; after each minute as many as take the cycle's median"""


@dataclass(frozen=True)
class Compared:
    """One figure of both revisions, a pair a round."""

    name: str
    unit: str
    base: list[float]
    here: list[float]

    def __str__(self) -> str:
        """A row of `HEAD`. The ratio is here over base."""
        ratios = np.array(self.here) / np.array(self.base)
        return (
            f"| {self.name} | {np.median(self.base):.4g} | {np.median(self.here):.4g} "
            f"| {self.unit} | {np.median(ratios):.2f} | {ratios.min():.2f} to {ratios.max():.2f} |"
        )


HEAD = (
    "| figure | {base} | here | | ratio of the pairs, median | lowest to highest |\n"
    "|---|---|---|---|---|---|"
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("base", help="the earlier revision, as git names it")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--configs", nargs="+", default=CONFIGS, choices=CONFIGS)
    parser.add_argument("--seconds", type=float, default=_LONG_S, help="the longer virtual run")
    parser.add_argument("--realtime", type=float, default=_REALTIME_S, help="s of each; 0: none")
    parser.add_argument("--misses", type=int, metavar="MINUTES", help="misses in real time alone")
    given = parser.parse_args()
    if given.misses is not None and given.misses < 1:
        parser.error(f"--misses {given.misses}: give a number of minutes, 1 or more")
    here = Path.cwd()
    base = checkout(given.base, here)
    if given.misses:
        misses(base, here, given.misses)
        return
    print(f"base: {base.name}; a fixed loop of Python takes {fixed_loop_ms():.1f} ms here")
    print(HEAD.format(base=given.base))
    for config in given.configs:
        for row in virtual(base, here, config, given.rounds, given.seconds):
            print(row, flush=True)
    for row in realtime(base, here, given.rounds, given.realtime) if given.realtime else ():
        print(row, flush=True)


def checkout(base: str, here: Path) -> Path:
    """A clone of ``here`` at ``base`` with its environment. Ends with one line if there is none."""
    named = subprocess.run(
        ["git", "rev-parse", "--verify", "--quiet", f"{base}^{{commit}}"],  # noqa: S607
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
    )
    if named.returncode:
        print(f"{base}: git knows no such revision; name a commit or a tag", file=sys.stderr)
        sys.exit(2)
    clone = here / "out" / "revisions" / named.stdout.strip()[:12]
    if not clone.exists():
        clone.parent.mkdir(parents=True, exist_ok=True)
        _git("clone", "--quiet", "--no-checkout", str(here), str(clone))
    _git("-C", str(clone), "checkout", "--quiet", "--force", named.stdout.strip())
    subprocess.run(["make", "--quiet", "setup"], cwd=clone, check=True)  # noqa: S607
    return clone


def virtual(
    base: Path, here: Path, config: str, rounds: int, seconds: float = _LONG_S
) -> list[Compared]:
    """Processor time of a tick, and the multiple of real time, of a load test with recording."""
    costs: dict[Path, list[float]] = {base: [], here: []}
    speeds: dict[Path, list[float]] = {base: [], here: []}
    options = ["--virtual", "--duration"]
    for where in (base, here):
        _run(where, config, *options, str(_SHORT_S))  # compiles what it was not run with yet
    for where in _alternating(base, here, rounds):
        short_s, brief = _run(where, config, *options, str(_SHORT_S))
        long_s, summary = _run(where, config, *options, str(seconds))
        # Counted, since revisions may take different times to stop.
        costs[where].append(1e6 * (long_s - short_s) / (summary["ticks"] - brief["ticks"]))
        speeds[where].append(float(summary["realtime_factor"]))
    return [
        Compared(f"a virtual tick, {config}.yaml", "us", costs[base], costs[here]),
        Compared(f"virtual time, {config}.yaml", "x", speeds[base], speeds[here]),
    ]


def realtime(base: Path, here: Path, rounds: int, seconds: float) -> list[Compared]:
    """Ticks in real time on the CAN lab: computing, the whole cycle, and what was missed."""
    figures = {
        "computing, p50": ("compute_us", "p50"),
        "cycle, p50": ("cycle_us", "p50"),
        "cycle, p99.9": ("cycle_us", "p99_9"),
    }
    found: dict[str, dict[Path, list[float]]] = {name: {base: [], here: []} for name in figures}
    own: dict[Path, list[int]] = {base: [], here: []}
    for where in _alternating(base, here, rounds):
        _, summary = _run(where, "can", "--duration", str(seconds))
        for name, (key, share) in figures.items():
            found[name][where].append(float(summary[key][share]))
        own[where].append(summary["missed_ticks"])
    print(f"own misses of each run: base {own[base]}, here {own[here]}")
    return [Compared(name, "us", of[base], of[here]) for name, of in found.items()]


def misses(base: Path, here: Path, minutes: int) -> None:
    """Prints a row a minute of each, and the sums. A run's bring-up counts as well."""
    print(
        "| minute | own misses: base | here | fixed | by the host: base | here "
        "| cycle, p50 / p99.9, us: base | here | fixed |\n|---|---|---|---|---|---|---|---|---|"
    )
    sums, steps = np.zeros(5, dtype=int), _STEPS
    for minute in range(1, minutes + 1):
        order = (base, here) if minute % 2 else (here, base)
        runs = {where: _run(where, "can", *_HOLD)[1] for where in order}
        spans, processor_us = fixed_computation(_MINUTE_S, steps)
        pair = [runs[base], runs[here]]
        counts = [run["missed_ticks"] for run in pair] + [int((processor_us // _PERIOD_US).sum())]
        counts += [run["missed_by_host"] for run in pair]
        cycles = [(run["cycle_us"]["p50"], run["cycle_us"]["p99_9"]) for run in pair]
        cycles.append(tuple(np.percentile(spans, (50.0, 99.9))))
        cells = [str(minute), *map(str, counts)]
        cells += [f"{median:.0f} / {tail:.0f}" for median, tail in cycles]
        print(f"| {' | '.join(cells)} |", flush=True)
        for where, run in runs.items():
            if run["state"] != "STANDBY":
                print(f"{where.name}: {run['state']}, {run['reason']}", flush=True)
        sums += counts
        steps = round(steps * cycles[1][0] / cycles[2][0])
    print(f"| all | {' | '.join(map(str, sums))} | | | |")


def _alternating(base: Path, here: Path, rounds: int) -> Iterator[Path]:
    """Each first in every other round."""
    for number in range(rounds):
        yield from (base, here) if number % 2 else (here, base)


def _run(where: Path, config: str, *options: str) -> tuple[float, dict[str, Any]]:
    """Processor time (s) of a run and of what it started, and its summary."""
    with tempfile.TemporaryDirectory() as out:
        before = os.times()
        command = [".venv/bin/tonus", "run", f"config/{config}.yaml", *options, "--out", out]
        subprocess.run(command, cwd=where, capture_output=True, check=False)
        after = os.times()
        summary = Path(out, "summary.json")
        if not summary.is_file():
            print(f"{where.name}: {' '.join(command)} has no summary", file=sys.stderr)
            sys.exit(1)
        spent = (
            after.children_user
            - before.children_user
            + after.children_system
            - before.children_system
        )
        return spent, json.loads(summary.read_text())


def _git(*words: str) -> None:
    subprocess.run(["git", *words], check=True)  # noqa: S607


if __name__ == "__main__":
    main()
