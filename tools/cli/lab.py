"""`tonus lab`: only the lab, in real time, on the configuration's buses."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import click

from tonus.config import load
from tonus.config.places import runtime_dir
from tonus.config.schema.bus import CanopenBus, of_kind
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.timing import clock
from tonus.tools import output
from tonus.tools.errors import ToolError
from tonus.tools.run.lab_process import work
from tonus.tools.run.tracker_address import need_known
from tonus.tools.settings import overrides_of


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--scenario", help="Whose lab: section (load, phantom, faults) is played.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the lab's noise.")
@click.option(
    "--nodes",
    metavar="LIST",
    help="Emulate only these, as in can0/1,can0/17,can2; the others are elsewhere on the bus.",
)
@click.option(
    "--set", "settings_", multiple=True, metavar="KEY=VALUE", help="One value of the configuration."
)
def lab(
    config: Path,
    scenario: str | None,
    seed: int | None,
    nodes: str | None,
    settings_: tuple[str, ...],
) -> None:
    """Start the lab of CONFIG: drives, load cells and tracker, with the plant behind them.

    A daemon that joins it needs the same values with --set.
    """
    output.make_optional()
    settings, played = load(config, scenario, overrides_of(settings_))
    if settings.lab is None:
        raise ToolError(f"{config}: has no lab: section; add one, see config/can.yaml")
    need_known(settings)
    chosen = None if nodes is None else _chosen(settings, config, nodes)
    seed = settings.lab.seed if seed is None else seed
    clock.run(_until_interrupted(settings, played, seed, chosen), virtual=False)


def _chosen(config: Config, path: Path, nodes: str) -> frozenset[tuple[str, int]]:
    """What --nodes names. Raises `ToolError` for what is not there."""
    if config.fieldbus.kind != "canopen":
        raise ToolError(f"{path}: --nodes: fieldbus.kind is {config.fieldbus.kind}, without nodes")
    there: dict[str, set[tuple[str, int]]] = {}
    for channel in of_kind(config.fieldbus, CanopenBus)[0].channels:
        node_ids = [node.number for node in channel.nodes()]
        there[channel.name] = {(channel.name, node_id) for node_id in node_ids}
        for node_id in node_ids:
            there[f"{channel.name}/{node_id}"] = {(channel.name, node_id)}
    chosen: set[tuple[str, int]] = set()
    for name in map(str.strip, nodes.split(",")):
        if name not in there:
            known = ", ".join(there)
            raise ToolError(f"{path}: --nodes: there is no {name!r}; choose of {known}")
        chosen |= there[name]
    return frozenset(chosen)


async def _until_interrupted(
    config: Config, scenario: Scenario, seed: int, nodes: frozenset[tuple[str, int]] | None
) -> None:
    where = runtime_dir()
    loop = asyncio.get_running_loop()
    working = loop.create_task(
        work(
            config,
            scenario,
            seed,
            None,
            lambda _: click.echo(f"lab of {config.name} on {where}; Ctrl-C ends it"),
            nodes,
        )
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, working.cancel)
    try:
        await working
    except asyncio.CancelledError:
        click.echo("lab closed")
