"""`tonus`: every command, and the one place where an error becomes a line and an exit code.

Exit codes: 0 done; 1 the run ended in a fault or a check failed; 2 bad usage or bad input.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

import click

from tonus.tools import output
from tonus.tools.cli.lazy import LazyGroup

COMMANDS = {
    "run": "Run the robot, or its lab: bring up, play a scenario, record.",
    "ctl": "Command a running daemon.",
    "lab": "Start the lab by itself: drives, load cells and tracker.",
    "fault": "Inject a fault into a running lab.",
    "check": "Validate a configuration: bus load, workspace, margins.",
    "verify": "Play scenarios with expectations, as acceptance tests.",
    "view": "Show the robot in a browser, live or from a log.",
    "doctor": "Measure whether this host can keep the period.",
    "workspace": "Map where the robot holds which forces.",
    "tune": "Tune controllers, or design the tension loop.",
    "log": "Inspect, compare, replay and convert recorded runs.",
    "paper": "Play the paper's stages and judge them.",
    "campaign": "Play studies of parameters, or faults at random.",
    "export": "Describe a configuration for other tools: DBC, EDS, ESI.",
    "init": "Write a complete, commented configuration to start from.",
    "new": "Write a project with HIL tests to start from.",
}


class _Commands(LazyGroup):
    """Commands whose kernels may have to be compiled, which is then shown."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.lines:
            return None
        with _loading():
            compiling = import_module("tonus.tools.cli.compiling")
            compiling.keep_somewhere()
            command = super().get_command(ctx, cmd_name)
            compiling.tell()
        return command


@click.group(cls=_Commands, package="tonus.tools.cli", lines=COMMANDS)
@click.version_option(package_name="tonus")
def tonus() -> None:
    """Control software of a cable-driven parallel robot, and its lab in software."""


def main() -> None:
    """One command, from its words to the process's exit code."""
    output.install()
    code: object = 1
    try:
        # Outside its standalone mode click returns the code of an Exit instead of leaving with it.
        code = tonus(standalone_mode=False)
    except SystemExit as ending:
        code = ending.code
    except KeyboardInterrupt:
        pass
    except Exception as error:  # noqa: BLE001  # what has no explanation is raised again
        with _loading():  # seldom needed, and it loads every room
            from tonus.tools.cli.failures import explained
        text, code = explained(error)
        if text:
            click.echo(text, err=True)
    sys.exit(_heard(code if isinstance(code, int) else 0))


def _heard(code: int) -> int:
    """The exit code, or 2 where the command did its work and its answer could not be written."""
    lost = output.lost()
    if lost is None:
        return code
    click.echo(f"tonus: {lost}; redirect the output elsewhere", err=True)
    return code or (0 if output.is_optional() else 2)


@contextmanager
def _loading() -> Iterator[None]:
    """Imports take a second, and an interrupt within one could surface anywhere: it ends the
    process at once, since nothing has begun."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(1))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
