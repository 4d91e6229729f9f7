"""`tonus log`: a file for each of its commands."""

from __future__ import annotations

import click

from tonus.tools.cli.log_compare import compare
from tonus.tools.cli.log_export import export
from tonus.tools.cli.log_identify import identify
from tonus.tools.cli.log_info import info
from tonus.tools.cli.log_layout import layout
from tonus.tools.cli.log_recover import recover
from tonus.tools.cli.log_replay import replay
from tonus.tools.cli.log_report import report
from tonus.tools.cli.log_timing import timing


@click.group()
def log() -> None:
    """Look into recorded runs."""


for command in (compare, export, identify, info, layout, recover, replay, report, timing):
    log.add_command(command)
