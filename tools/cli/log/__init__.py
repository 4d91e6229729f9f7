"""`tonus log`: a file for each of its commands."""

from __future__ import annotations

import click

from tonus.tools.cli.log.compare import compare
from tonus.tools.cli.log.export import export
from tonus.tools.cli.log.identify import identify
from tonus.tools.cli.log.info import info
from tonus.tools.cli.log.layout import layout
from tonus.tools.cli.log.recover import recover
from tonus.tools.cli.log.replay import replay
from tonus.tools.cli.log.report import report
from tonus.tools.cli.log.timing import timing


@click.group()
def log() -> None:
    """Inspect, compare, replay and convert recorded runs."""


for command in (compare, export, identify, info, layout, recover, replay, report, timing):
    log.add_command(command)
