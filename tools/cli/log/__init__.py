"""`tonus log`: a file for each of its commands."""

from __future__ import annotations

import click

from tonus.tools.cli.lazy import LazyGroup

LINES = {
    "compare": "Compare runs by the indicators of the paper.",
    "export": "Write a table for each topic, or the bus frames.",
    "figure": "Draw one figure of a run, or of several.",
    "identify": "Identify masses, cables, drums and the closed loop.",
    "info": "Print time, states, faults, topics and gaps.",
    "layout": "Write a layout for a viewer of logs.",
    "recover": "Save what a damaged log still holds.",
    "replay": "Compute a run again, and compare bit for bit.",
    "report": "Write a run as one HTML page.",
    "timing": "Judge a run's timing by its budget.",
}


@click.group(cls=LazyGroup, package=__name__, lines=LINES)
def log() -> None:
    """Inspect, compare, replay and convert recorded runs."""
