"""`tonus lab`: only the lab, in real time, on the configuration's buses."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import click

from config import load
from config.places import runtime_dir
from config.schema.root import Config
from config.schema.scenario import Scenario
from runtime import clock
from tools.errors import ToolError
from tools.lab_process import work


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--scenario", help="Whose lab: section (load, phantom, faults) is played.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the lab's noise.")
def lab(config: Path, scenario: str | None, seed: int | None) -> None:
    """Start the lab of CONFIG: drives, force cells and tracker, with the plant behind them."""
    settings, played = load(config, scenario)
    if settings.lab is None:
        raise ToolError(f"{config}: has no lab: section; add one, see config/can.yaml")
    clock.run(
        _until_interrupted(settings, played, settings.lab.seed if seed is None else seed),
        virtual=False,
    )


async def _until_interrupted(config: Config, scenario: Scenario, seed: int) -> None:
    where = runtime_dir()
    loop = asyncio.get_running_loop()
    working = loop.create_task(
        work(
            config,
            scenario,
            seed,
            None,
            lambda: click.echo(f"lab of {config.name} on {where}; Ctrl-C ends it"),
        )
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, working.cancel)
    try:
        await working
    except asyncio.CancelledError:
        click.echo("lab closed")
