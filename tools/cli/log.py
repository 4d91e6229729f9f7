"""`tonus log`: a file for each of its commands."""

from __future__ import annotations

import click

from tools.cli.log_export import export
from tools.cli.log_identify import identify
from tools.cli.log_info import info
from tools.cli.log_recover import recover
from tools.cli.log_replay import replay


@click.group()
def log() -> None:
    """Look into recorded runs."""


for command in (export, identify, info, recover, replay):
    log.add_command(command)
