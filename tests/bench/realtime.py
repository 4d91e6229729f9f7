"""The daemon with lab and recorder, in alternation with cyclictest: `make bench-realtime`.

A third thing takes its turn: a fixed computation, once a millisecond, by a thread with all that the
daemon asks of the host. How much longer it takes at times is the host's doing alone.

    python -m tests.bench.realtime [--minutes M] [--write]

Prints the figures beside what they are to be; with --write the histogram goes into docs/timing.png
and the table into docs/timing.md. Exits with 1 when one is missed.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure as Picture
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tests.bench.measure import Figure
from tests.bench.played import CONFIG, Played, p99_9, play, together
from tonus.config import load
from tonus.runtime.timing.clock import Stopwatch, no_stalls
from tonus.runtime.timing.histogram import Histogram
from tonus.runtime.timing.realtime import Hygiene, settled, stolen_jiffies
from tonus.tools.doctor.wakeup import bare, cyclictest
from tonus.tools.report import style
from tonus.tools.run.stall_watch_process import stall_watch

Array = NDArray[np.float64]
_STRETCH_S = 30.0
_STEPS = 10_000
_SHORT_S, _SHORT_ROUNDS = 10.0, 2
_PERIOD_NS = 1_000_000
_PERIOD_US = 1e3
_WAKEUP_RATIO, _AIM = 6.0, 3.0
_CYCLE_US = 500.0
_LATE_RATIO = 2.0
_DOCS = Path("docs/timing.md")
_BEGIN, _END = "<!-- measured by make bench-realtime -->\n", "<!-- end -->\n"


@dataclass(frozen=True)
class Alternation:
    """What both have measured in equal stretches, one after the other."""

    daemon: Played
    peer: Histogram
    peer_name: str
    fixed: Array
    """us, times that the fixed computation took"""
    overruns: int
    """whole periods that it ran for, by its processor time less the host's stalls: of a daemon they
    are its own misses"""
    steal_percent: float


@dataclass(frozen=True)
class Row:
    """A figure beside what it is to be."""

    name: str
    value: str
    wanted: str
    met: bool


def realtime() -> list[Figure]:
    """A short alternation, for the table of `make bench`."""
    found = alternate(_SHORT_ROUNDS, _SHORT_S, lambda _: None)
    daemon, peer = found.daemon, found.peer
    note = f"{len(daemon.wakeup)} ticks, {found.steal_percent:.2f} % stolen"
    return [
        Figure(
            "wake-up of a tick, p99.9",
            p99_9(daemon.wakeup), "us", found.peer_name, peer.at(0.999) * 1e-3, note,
        ),
        Figure("computing in real time, median", _median(daemon.act), "us", "aim", 80.0),
        Figure("cycle in real time, median", _median(daemon.cycle), "us", "aim", 200.0),
        Figure("cycle in real time, p99.9", p99_9(daemon.cycle), "us", "limit", _CYCLE_US),
        Figure(
            "cycle in real time, p99.9 over its median",
            _tail(daemon.cycle), "x", "a fixed computation", _tail(found.fixed), "aim: 2",
        ),
        Figure(
            "missed ticks of our own, a million",
            _per_million(daemon.own, len(daemon.wakeup)), "", "a fixed computation",
            _per_million(found.overruns, len(found.fixed)),
            f"{daemon.own} of {len(daemon.wakeup)} ticks, {found.overruns} of {len(found.fixed)}",
        ),
        Figure(
            "late wake-ups a million",
            _per_million(daemon.late, len(daemon.wakeup)), "", found.peer_name,
            _per_million(peer.beyond(_PERIOD_NS), peer.count),
        ),
    ]  # fmt: skip


def alternate(rounds: int, seconds: float, say: Callable[[str], None]) -> Alternation:
    """``seconds`` of each, ``rounds`` times."""
    runs: list[Played] = []
    fixed: list[Array] = []
    processor: list[Array] = []
    peer, name = Histogram(), "cyclictest"
    before = stolen_jiffies()
    for number in range(1, rounds + 1):
        say(f"round {number} of {rounds}: cyclictest for {seconds:g} s")
        found = cyclictest(seconds)
        if found is None:
            name, found = "bare thread", _bare(seconds)
        peer.merge(found)
        spans, own = fixed_computation(seconds / 6.0)
        fixed.append(spans)
        processor.append(own)
        say(f"round {number} of {rounds}: the daemon for {seconds:g} s and its bring-up")
        runs.append(play(seconds))
    stolen, total = (now - then for now, then in zip(stolen_jiffies(), before, strict=True))
    share = 100.0 * stolen / total if total else 0.0
    overruns = int((np.concatenate(processor) // _PERIOD_US).sum())
    return Alternation(together(runs), peer, name, np.concatenate(fixed), overruns, share)


def fixed_computation(seconds: float, steps: int = _STEPS) -> tuple[Array, Array]:
    """us that ever the same computing took, as long as a tick's, after each of a bare thread's
    wake-ups: by the wall's clock, and by the thread's own less the stalls of the host that a watch
    saw meanwhile, as the daemon counts."""
    settings = settled(load(CONFIG)[0].realtime)
    watched = stall_watch(settings, print)
    hygiene, watch = Hygiene(settings), Stopwatch(running=True)
    wall_ns, processor_ns = watch.wall_ns, watch.processor_ns
    stalled_ns = no_stalls if watched is None else watched.stalls.until
    spans: list[float] = []
    own: list[float] = []

    def compute() -> None:
        began, total = wall_ns(), 0
        stalled, spent = stalled_ns(began), processor_ns()
        for number in range(steps):
            total += number
        spent, ended = processor_ns() - spent, wall_ns()
        own.append(max(spent - (stalled_ns(ended) - stalled), 0) * 1e-3)
        spans.append((ended - began) * 1e-3)

    try:
        bare(seconds, compute)
        return np.array(spans), np.array(own)
    finally:
        hygiene.release()
        if watched is not None:
            watched.process.stop()


def _bare(seconds: float) -> Histogram:
    hygiene = Hygiene(load(CONFIG)[0].realtime)
    try:
        return bare(seconds)
    finally:
        hygiene.release()


def rows(found: Alternation) -> list[Row]:
    """Each figure beside what it is to be."""
    daemon, peer = found.daemon, found.peer
    ours, theirs = p99_9(daemon.wakeup), peer.at(0.999) * 1e-3
    late = _per_million(daemon.late, len(daemon.wakeup))
    peer_late = _per_million(peer.beyond(_PERIOD_NS), peer.count)
    # One late wake-up more than nothing is no frequency yet.
    rare = daemon.late <= max(1, _LATE_RATIO * peer_late * len(daemon.wakeup) * 1e-6)
    cycle = p99_9(daemon.cycle)
    return [
        Row(
            "wake-up, p99.9",
            f"{ours:.1f} us, {found.peer_name} {theirs:.1f} us: {ours / theirs:.2f} x",
            f"at most {_WAKEUP_RATIO:g} x, aim {_AIM:g} x",
            ours <= _WAKEUP_RATIO * theirs,
        ),
        Row(
            "of it computing (act), p99.9",
            f"{p99_9(daemon.act):.0f} us",
            f"at most {_CYCLE_US:.0f} us",
            p99_9(daemon.act) <= _CYCLE_US,
        ),
        Row(
            "cycle, p99.9",
            f"{cycle:.0f} us, {_tail(daemon.cycle):.2f} x its median; the fixed computation "
            f"{_tail(found.fixed):.2f} x",
            f"at most {_CYCLE_US:.0f} us",
            cycle <= _CYCLE_US,
        ),
        Row(
            "ticks missed, our own",
            f"{daemon.own}, {_per_million(daemon.own, len(daemon.wakeup)):.0f} a million; the "
            f"fixed computation {_per_million(found.overruns, len(found.fixed)):.0f}",
            "0",
            daemon.own == 0,
        ),
        Row(
            "late wake-ups by the host",
            f"{late:.0f} a million, {found.peer_name} {peer_late:.0f}",
            f"at most {_LATE_RATIO:g} x",
            rare,
        ),
        Row(
            "runs that ended in a fault",
            "; ".join(daemon.faults) or "0",
            "0",
            not daemon.faults,
        ),
    ]


def _median(values: Array) -> float:
    return float(np.median(values))


def _tail(values: Array) -> float:
    return p99_9(values) / _median(values)


def _per_million(count: int, of: int) -> float:
    return 1e6 * count / of if of else 0.0


def percentiles(found: Alternation) -> list[tuple[str, list[float]]]:
    """p50, p99, p99.9 and max in us of each thing measured."""
    peer, daemon = found.peer, found.daemon
    table = [(found.peer_name, [peer.at(q) * 1e-3 for q in (0.5, 0.99, 0.999)])]
    table[0][1].append(peer.largest * 1e-3)
    for name, values in (
        ("wakeup", daemon.wakeup),
        ("act", daemon.act),
        ("cycle", daemon.cycle),
        ("response", daemon.response),
        ("whole", daemon.whole),
        ("fixed computation", found.fixed),
    ):
        table.append((name, [float(np.percentile(values, q)) for q in (50.0, 99.0, 99.9, 100.0)]))
    return table


def machine() -> str:
    """What the figures were taken on."""
    model = "processor unknown"
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    kernel = f"Linux {platform.release()} ({platform.version()})"
    return f"{model}, {os.cpu_count()} processors, {kernel}"


def picture(found: Alternation, path: Path) -> None:
    """Counts over latency, both on axes that show the rare."""
    figure = Picture(figsize=(9.0, 4.2), layout="constrained")
    panel = figure.subplots()
    edges = np.geomspace(0.1, 1.2e4, 140)
    uppers, counts = np.array(list(found.peer.filled())).T
    daemon = found.daemon
    for values, weights, label, colour in (
        (uppers * 1e-3, counts, f"{found.peer_name}, wake-up", style.BLACK),
        (daemon.wakeup, None, "daemon, wake-up", style.BLUE),
        (daemon.cycle, None, "daemon, cycle", style.ORANGE),
        (daemon.response, None, "daemon, due to published", style.GREEN),
    ):
        panel.hist(
            np.maximum(values, edges[0]),
            edges.tolist(),
            weights=weights,
            histtype="step",
            color=colour,
            label=label,
        )
    panel.axvline(1e3, color="0.25", linestyle=style.DASHES, label="period")
    panel.set(xscale="log", yscale="log", xlabel="µs", ylabel="ticks")
    panel.set_title(f"{len(daemon.wakeup)} ticks, {found.peer.count} wake-ups of the peer")
    panel.grid(color="0.88", linewidth=0.6)
    panel.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)


def write(found: Alternation, seconds: float) -> None:
    """Put picture and tables between the marks in docs/timing.md."""
    picture(found, _DOCS.with_suffix(".png"))
    lines = [
        f"{machine()}. In alternation, {seconds:g} s each: {found.peer.count} wake-ups of "
        f"`{found.peer_name} -p80 -i1000` alone, {len(found.daemon.wakeup)} ticks of the daemon "
        f"with lab and recorder, {len(found.fixed)} fixed computations; "
        f"{found.steal_percent:.2f} % of processor time stolen. µs.\n",
        "| | p50 | p99 | p99.9 | max |\n|---|---|---|---|---|",
    ]
    for name, values in percentiles(found):
        lines.append(f"| {name} | " + " | ".join(f"{value:.1f}" for value in values) + " |")
    lines.append("\n| figure | measured | to be | |\n|---|---|---|---|")
    for row in rows(found):
        verdict = "met" if row.met else "**missed**"
        lines.append(f"| {row.name} | {row.value} | {row.wanted} | {verdict} |")
    text = _DOCS.read_text(encoding="utf-8")
    head, _, rest = text.partition(_BEGIN)
    tail = rest.partition(_END)[2]
    body = "\n".join(lines) + "\n\n![Histogram of wake-ups and cycles](timing.png)\n"
    _DOCS.write_text(f"{head}{_BEGIN}\n{body}{_END}{tail}", encoding="utf-8")


@click.command()
@click.option("--minutes", type=click.FloatRange(min=0.1), default=10.0, show_default=True)
@click.option("--write", "written", is_flag=True, help="Put the result into docs/timing.md.")
def main(minutes: float, *, written: bool) -> None:
    """Alternate cyclictest and the daemon for so many minutes of both together."""
    console = Console(highlight=False, soft_wrap=True)
    seconds = min(_STRETCH_S, 30.0 * minutes)
    rounds = max(round(60.0 * minutes / (2.0 * seconds)), 1)
    found = alternate(rounds, seconds, lambda text: console.print(f"  {text}"))
    table = Table("us", "p50", "p99", "p99.9", "max")
    for name, values in percentiles(found):
        table.add_row(name, *(f"{value:.1f}" for value in values))
    console.print(table)
    verdicts = Table("figure", "measured", "to be", "")
    judged = rows(found)
    for row in judged:
        verdicts.add_row(row.name, row.value, row.wanted, "met" if row.met else "MISSED")
    console.print(verdicts)
    console.print(f"{machine()}; {found.steal_percent:.2f} % of processor time stolen")
    if written:
        write(found, seconds)
    sys.exit(0 if all(row.met for row in judged) else 1)


if __name__ == "__main__":
    main()
