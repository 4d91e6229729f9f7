"""`tonus log info`: what a log holds."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tonus.runtime.states import State
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.run.summary import find_faults

_S = 1e-9
_CYCLE_FIELDS = {
    "/tonus/state": ("state", "fault", "fault_where"),
    "/tonus/timing": ("tick",),
}
"""what it takes to tell states and faults"""
_STATES = frozenset(State)
_GAP_FACTOR = 1.5
"""a silence longer than this many usual intervals is a gap"""
_VIRTUAL_BEFORE_NS = 365 * 24 * 3600 * 1_000_000_000
"""log_time this near to zero is virtual time, not UTC"""


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list instead of tables.")
def info(files: tuple[Path, ...], as_json: bool) -> None:
    """Print time, duration, states, faults, topics with rates and gaps, and damage. Exit code
    1 for a damaged file."""
    described = [describe(open_log(file)) for file in files]
    if as_json:
        click.echo(json.dumps(described, indent=2))
    else:
        console = Console(highlight=False)
        for description in described:
            _show(console, description)
    if any(description["damage"] for description in described):
        raise click.exceptions.Exit(1)


def describe(log: Log) -> dict[str, Any]:
    """Everything `tonus log info` tells about a log, ready for JSON."""
    log.load()
    damage = log.damage
    if damage is None and not log.is_as_written():
        damage = "something between the chunks is not as it was written"
    span = log.span_ns
    start = span[0] if span else 0
    known = all(log.has(topic, *fields) for topic, fields in _CYCLE_FIELDS.items())
    known = known and len(log["/tonus/state"]) == len(log["/tonus/timing"])
    return {
        "file": str(log.path),
        "bytes": log.path.stat().st_size,
        "start": _when(span[0]) if span else None,
        "duration_s": (span[1] - span[0]) * _S if span else 0.0,
        "metadata": log.metadata,
        "attachments": {name: len(data) for name, data in log.attachments.items()},
        "states": _states(log, start) if known else [],
        "faults": find_faults(log) if known else [],
        "events": [
            {
                "time_s": (event.time_ns - start) * _S,
                "tick": event.tick,
                "level": event.level,
                "name": event.name,
                "where": event.where,
                "text": event.text,
            }
            for event in log.events()
        ],
        "topics": [_topic(log, topic) for topic in log.topics],
        "lost": {name: int(count) for name, count in log.recorded.items() if int(count)},
        "damage": damage,
    }


def _states(log: Log, start: int) -> list[dict[str, Any]]:
    """The states in the order in which they were entered, by the clock of the events: s since
    ``start`` (ns), the log's first message."""
    state, times = log["/tonus/state"]["state"], log.times("/tonus/state")
    entered = np.flatnonzero(np.diff(state, prepend=-1) != 0) if len(state) else np.empty(0, int)
    ends = [*times[entered[1:]].tolist(), int(times[-1])]
    return [
        {
            "state": State(number).name
            if (number := int(state[index])) in _STATES
            else str(number),
            "from_s": float((times[index] - start) * _S),
            "duration_s": float((end - times[index]) * _S),
        }
        for index, end in zip(entered, ends, strict=True)
    ]


def _topic(log: Log, topic: str) -> dict[str, Any]:
    times, sequence = log.times(topic), log.sequence(topic)
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    bus = topic.startswith("/can/")
    periodic = not bus and len(steps) > 1 and usual > 0
    return {
        "topic": topic,
        "messages": len(times),
        "rate_hz": len(steps) / ((times[-1] - times[0]) * _S) if steps.any() else None,
        "gaps": int((steps > _GAP_FACTOR * usual).sum()) if periodic else None,
        "longest_gap_s": float(steps.max() * _S) if periodic else None,
        # Bus frames are numbered through all buses, so a step says nothing about one of them.
        "lost": None if bus else int(np.maximum(np.diff(sequence) - 1, 0).sum()),
    }


def _when(time_ns: int) -> str:
    if abs(time_ns) < _VIRTUAL_BEFORE_NS:
        return f"virtual time {time_ns * _S:.3f} s"
    return datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).isoformat()


def _show(console: Console, d: dict[str, Any]) -> None:
    console.print(f"[bold]{escape(d['file'])}[/]  {d['bytes'] / 1e6:.2f} MB")
    console.print(f"start {d['start'] or '-'}   duration {d['duration_s']:.3f} s")
    if d["metadata"]:
        values = "   ".join(f"{key} {value}" for key, value in d["metadata"].items())
        console.print(escape(values))
    if d["attachments"]:
        names = ", ".join(f"{name} ({size} bytes)" for name, size in d["attachments"].items())
        console.print(escape(f"attached: {names}"))
    if d["states"]:
        table = Table("state", "from s", "for s", title="States", title_justify="left")
        for row in d["states"]:
            table.add_row(row["state"], f"{row['from_s']:.3f}", f"{row['duration_s']:.3f}")
        console.print(table)
    for fault in d["faults"]:
        where = f" at {fault['where']}" if fault["where"] else ""
        text = f"fault {fault['name']}{where} in tick {fault['tick']} -> {fault['reaction']}"
        console.print(escape(text), style="red")
    if d["events"]:
        table = Table("s", "tick", "event", "where", "text", title="Events", title_justify="left")
        for event in d["events"]:
            cells = (event["name"], event["where"], event["text"])
            table.add_row(
                f"{event['time_s']:.3f}", str(event["tick"]), *(escape(cell) for cell in cells)
            )
        console.print(table)
    _show_topics(console, d)
    for name, count in d["lost"].items():
        console.print(f"{escape(name)}: {count} records were lost before the recorder", style="red")
    if d["damage"]:
        console.print(f"damaged: {escape(d['damage'])}; read up to there", style="red")


def _show_topics(console: Console, d: dict[str, Any]) -> None:
    table = Table("topic", title="Topics", title_justify="left")
    for name in ("messages", "rate Hz", "gaps", "longest s", "lost"):
        table.add_column(name, justify="right")
    for topic in d["topics"]:
        rate, gap = topic["rate_hz"], topic["longest_gap_s"]
        table.add_row(
            escape(topic["topic"]),
            str(topic["messages"]),
            "" if rate is None else f"{rate:.1f}",
            "" if topic["gaps"] is None else str(topic["gaps"]),
            "" if gap is None else f"{gap:.4f}",
            "" if topic["lost"] is None else str(topic["lost"]),
        )
    console.print(table)
