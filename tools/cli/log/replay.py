"""`tonus log replay`: the recorded inputs once more through the control cycle."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from tonus.config import load
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import Difference, Replay
from tonus.tools.log.replay import replay as carry_out

_SHOWN = 12


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--with", "other", type=click.Path(path_type=Path), help="Another configuration.")
@click.option("--from", "first", type=click.IntRange(min=0), help="First tick to compare.")
@click.option("--to", "last", type=click.IntRange(min=0), help="Last tick to compare.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
def replay(
    files: tuple[Path, ...],
    other: Path | None,
    first: int | None,
    last: int | None,
    *,
    as_json: bool,
) -> None:
    """Feed the inputs in FILES, the segments of one run, to the control cycle and compare every
    output bit for bit; or, --with another configuration, print what it would have commanded."""
    log = open_log(files)
    config = load(other)[0] if other else None
    with Console(stderr=True).status("replaying") as status:
        found = carry_out(
            log,
            other=config,
            first=first,
            last=last,
            progress=lambda tick: status.update(f"replaying, tick {tick}"),
        )
    if not found.ticks:
        raise ToolError(f"{files[0]}: no tick to compare there; choose another --from or --to")
    if as_json:
        click.echo(json.dumps(_plain(log, found), indent=2))
    elif config is not None:
        _tell_changes(found, str(other))
    else:
        _tell(log, found)
    if found.first is not None or log.damage:
        raise click.exceptions.Exit(1)


def _tell(log: Log, found: Replay) -> None:
    span = f"{found.ticks} ticks, {found.first_tick} to {found.last_tick}"
    if found.keyframes:
        span += f", begun at the keyframe of tick {', '.join(map(str, found.keyframes))}"
    click.echo(span)
    _tell_unchecked(found)
    if log.damage:
        click.echo(f"damaged: {log.damage}; replayed up to there")
    if found.first is None:
        click.echo("bit-equal: every output is the same")
        return
    click.echo(f"not equal, first in {_worded(found.first)}")
    often = sorted(found.differing.items(), key=lambda item: -item[1])
    for signal, count in often[:_SHOWN]:
        click.echo(f"  {signal:<36} differs in {count} ticks")
    if len(often) > _SHOWN:
        click.echo(f"  and {len(often) - _SHOWN} more signals")
    for name, (then, now) in _other_versions(log).items():
        click.echo(f"recorded with {name} {then}, replayed with {now}")


def _tell_unchecked(found: Replay) -> None:
    for first, last in found.unchecked:
        click.echo(f"not replayed: {first} to {last}; records are missing before, and a keyframe")


def _worded(first: Difference) -> str:
    if first.field == "inputs":
        return (
            f"tick {first.tick}: an input is not what it was "
            f"(checksum {int(first.recorded):#010x}, now {int(first.replayed):#010x})"
        )
    return (
        f"tick {first.tick}, {first.place}: recorded {_exact(first.recorded)}, "
        f"replayed {_exact(first.replayed)}"
    )


def _exact(value: np.generic) -> str:
    """All digits, and for a float its bits."""
    if isinstance(value, np.floating):
        return f"{float(value)!r} ({float(value).hex()})"
    return str(value)


def _tell_changes(found: Replay, name: str) -> None:
    click.echo(f"{name} on the inputs of ticks {found.first_tick} to {found.last_tick}, RMS:")
    for change in found.changes:
        click.echo(
            f"  {change.signal:<30} {change.replayed:12.5g} instead of {change.recorded:.5g} "
            f"{change.unit}, apart {change.rms:.5g}, most {change.largest:.5g} "
            f"in tick {change.at_tick}"
        )
    _tell_unchecked(found)
    click.echo(f"  in the recorded state in {found.same_state} of {found.ticks} ticks")
    click.echo("The inputs are those of the recorded run: they do not answer to these commands.")


def _other_versions(log: Log) -> dict[str, tuple[str, str]]:
    """Libraries that were of another version then."""
    then = {
        key.removeprefix("version."): value
        for key, value in log.metadata.items()
        if key.startswith("version.") and key != "version.python"
    }
    now = {name: _installed(name) for name in then}
    return {name: (then[name], now[name]) for name in then if then[name] != now[name]}


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _plain(log: Log, found: Replay) -> dict[str, Any]:
    data = asdict(found)
    for change in data["changes"]:
        change.pop("_count")
    if found.first is not None:
        first = found.first
        data["first"] |= {
            "recorded": first.recorded.item(),
            "replayed": first.replayed.item(),
            "recorded_bits": first.recorded.tobytes()[::-1].hex(),
            "replayed_bits": first.replayed.tobytes()[::-1].hex(),
        }
    return {
        **data,
        "equal": None if found.changes else found.first is None,
        "damage": log.damage,
        "other_versions": _other_versions(log),
    }
