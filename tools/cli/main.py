"""`tonus`: every command, and the one place where an error becomes a line and an exit code.

Exit codes: 0 done; 1 the run ended in a fault or a check failed; 2 bad usage or bad input.
"""

from __future__ import annotations

import sys
from importlib import import_module

import click

from config.errors import ConfigError
from drivers.errors import DriverError
from runtime.errors import DaemonError
from sim.errors import LabError
from tools.errors import ToolError

COMMANDS = (
    "run",
    "ctl",
    "lab",
    "fault",
    "check",
    "doctor",
    "workspace",
    "tune",
    "log",
    "paper",
    "campaign",
    "export",
)
"""Each is the object of its name in the module of its name."""


_NO_CACHE = "no locator available"
"""numba's words where it finds no folder for what it compiles"""
_CACHE_ADVICE = (
    "compiled code can be kept neither beside the sources nor in the user's cache folder; "
    "set NUMBA_CACHE_DIR to a folder that may be written"
)


class _Commands(click.Group):
    """Imports a command when it is asked for, so that a light one is not kept waiting by others."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in COMMANDS:
            return None
        command = getattr(import_module(f"tools.cli.{cmd_name}"), cmd_name)
        assert isinstance(command, click.Command)
        return command


@click.group(cls=_Commands)
@click.version_option(package_name="tonus")
def tonus() -> None:
    """Control software of an eight-cable parallel robot, and its lab in software."""


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
    except RuntimeError as error:
        if _NO_CACHE not in str(error):
            raise
        click.echo(f"tonus: {_CACHE_ADVICE}", err=True)
        sys.exit(2)
