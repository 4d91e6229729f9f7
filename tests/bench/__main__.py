"""Run every benchmark, print the table, write bench.json."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench.control import control
from tests.bench.distribution import distribution
from tests.bench.ethercat import ethercat
from tests.bench.frames import frames
from tests.bench.log import log
from tests.bench.measure import Figure
from tests.bench.process_data import process_data
from tests.bench.realtime import realtime
from tests.bench.segment import segment
from tests.bench.whole import whole

PARTS = (control, distribution, process_data, frames, segment, ethercat, whole, log, realtime)


def main() -> None:
    figures: list[Figure] = []
    console = Console()
    for bench in PARTS:
        console.print(f"measuring {bench.__name__} ...")
        figures += bench()
    table = Table("what", "value", "peer", "peer's value", "ratio", "note")
    for figure in figures:
        peer = "" if figure.peer_value is None else f"{figure.peer_value:.4g} {figure.unit}"
        ratio = "" if figure.ratio is None else f"{figure.ratio:.2f}"
        value = f"{figure.value:.4g} {figure.unit}"
        table.add_row(figure.name, value, figure.peer, peer, ratio, figure.note)
    console.print(table)
    Path("bench.json").write_text(json.dumps([f.row() for f in figures], indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
