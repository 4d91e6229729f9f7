"""`tonus`: every command, and the one place where an error becomes a line and an exit code.

Exit codes: 0 done; 1 the run ended in a fault or a check failed; 2 bad usage or bad input.
"""

from __future__ import annotations

import sys

import click

from config.errors import ConfigError
from drivers.errors import DriverError
from runtime.errors import DaemonError
from sim.errors import LabError
from tools.cli.check import check
from tools.cli.lab import lab
from tools.cli.log import log
from tools.cli.run import run
from tools.cli.workspace import workspace
from tools.errors import ToolError


@click.group()
@click.version_option(package_name="tonus")
def tonus() -> None:
    """Control software of an eight-cable parallel robot, and its lab in software."""


for command in (run, lab, check, log, workspace):
    tonus.add_command(command)


def main() -> None:
    """Entry point of the console script."""
    try:
        # Outside its standalone mode click returns the code of an Exit instead of leaving with it.
        sys.exit(tonus(standalone_mode=False))
    except click.exceptions.Abort:
        sys.exit(1)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (ConfigError, LabError, ToolError) as error:
        click.echo(f"tonus: {error}", err=True)
        sys.exit(2)
    except (DriverError, DaemonError) as error:
        click.echo(f"tonus: {error}", err=True)
        sys.exit(1)
