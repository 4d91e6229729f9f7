"""`tonus log`: a file for each of its commands."""

from __future__ import annotations

import click

from tools.cli.log_export import export
from tools.cli.log_identify import identify
from tools.cli.log_info import info
from tools.cli.log_recover import recover
from tools.cli.log_replay import replay
from tools.cli.log_report import report


@click.group()
def log() -> None:
    """Look into recorded runs."""


for command in (export, identify, info, recover, replay, report):
    log.add_command(command)
