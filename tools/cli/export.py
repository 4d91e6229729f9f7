"""`tonus export`: descriptions of a configuration for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus, EthercatBus, of_kind
from tonus.sim.ethercat.slaves import esi as esi_file
from tonus.sim.lab.data_sheets import sheets
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.export import dbc as dbc_file
from tonus.tools.export import messages
from tonus.tools.folders import make_folder


@click.group()
def export() -> None:
    """Describe CONFIG for other tools, as DBC, EDS or ESI files."""


@export.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--channel", help="Only this channel's frames.")
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="A file, not standard output."
)
def dbc(config: Path, channel: str | None, out: Path | None) -> None:
    """Describe every frame of CONFIG's channels as a DBC file, in SI units."""
    loaded, _ = load(config)
    bus = _canopen(loaded, config)
    channels = tuple(each for each in bus.channels if channel in (None, each.name))
    if not channels:
        known = ", ".join(each.name for each in bus.channels)
        raise ToolError(f"{config}: has no channel {channel!r}; choose one of {known}")
    try:
        found = messages.messages(loaded, bus, channels)
    except ToolError as error:
        raise ToolError(f"{config}: {error}") from error
    text = dbc_file.write(messages.nodes(loaded, bus, channels), found)
    if out is None:
        click.echo(text, nl=False)
    else:
        _write(out, text)
        click.echo(f"{out}: {len(found)} frames of {', '.join(each.name for each in channels)}")


@export.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="A folder, not the present one.",
)
def eds(config: Path, out: Path) -> None:
    """Describe each kind of device that CONFIG's lab emulates as an EDS file (CiA 306)."""
    loaded, _ = load(config)
    _canopen(loaded, config)
    if loaded.lab is None:
        raise ToolError(f"{config}: has no lab: section; add one, see config/can.yaml")
    _write_all(out, sheets(loaded))


@export.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="A folder, not the present one.",
)
def esi(config: Path, out: Path) -> None:
    """Describe each kind of slave that CONFIG's lab emulates as an ESI file (ETG.2000)."""
    loaded, _ = load(config)
    bus = loaded.fieldbus
    if not of_kind(bus, EthercatBus):
        raise ToolError(
            f"{config}: fieldbus.kind is {bus.kind}, which has no slaves; "
            "give a configuration on ethercat, as config/ethercat.yaml"
        )
    if loaded.lab is None:
        raise ToolError(f"{config}: has no lab: section; add one, see config/ethercat.yaml")
    _write_all(out, esi_file.files(loaded))


def _write_all(out: Path, files: dict[str, str]) -> None:
    make_folder(out)
    for name, text in files.items():
        _write(out / name, text)
        click.echo(out / name)


def _canopen(config: Config, path: Path) -> CanopenBus:
    if config.fieldbus.kind != "canopen":
        raise ToolError(
            f"{path}: fieldbus.kind is {config.fieldbus.kind}, which has no frames; "
            "give a configuration on canopen"
        )
    return of_kind(config.fieldbus, CanopenBus)[0]


def _write(path: Path, text: str) -> None:
    try:
        write_whole(path, text, "ascii")
    except OSError as error:
        raise ToolError(f"{path}: {error.strerror}; choose another with --out") from error
