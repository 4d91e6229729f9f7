"""`tonus log recover`: a damaged log written anew."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console

from tonus.tools.log.recover import Salvage
from tonus.tools.log.recover import recover as carry_out

_SHOWN = 5


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Default: FILE.recovered.mcap.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
def recover(file: Path, out: Path | None, *, as_json: bool) -> None:
    """Write what can be trusted in FILE to another file and prove that by reading it; FILE stays as
    it is."""
    out = file.with_name(f"{file.stem}.recovered.mcap") if out is None else out
    with Console(stderr=True).status("recovering") as status:
        salvage = carry_out(
            file, out, lambda share: status.update(f"recovering, {100.0 * share:.0f} %")
        )
    if as_json:
        known = None if salvage is None else asdict(salvage)
        click.echo(json.dumps({"file": str(out) if salvage else None, "salvage": known}, indent=2))
    elif salvage is None:
        click.echo(f"{file}: is complete; there is nothing to recover")
    else:
        _tell(out, salvage)


def _tell(out: Path, salvage: Salvage) -> None:
    count = sum(salvage.kept.values())
    ticks = "" if salvage.ticks is None else f", ticks {salvage.ticks[0]} to {salvage.ticks[1]}"
    click.echo(
        f"{out}: {count} messages in {salvage.end_s:.3f} s{ticks}; read back, every checksum holds"
    )
    for start, end in salvage.holes[:_SHOWN]:
        click.echo(f"  nothing between {start:.3f} and {end:.3f} s")
    if len(salvage.holes) > _SHOWN:
        click.echo(f"  and {len(salvage.holes) - _SHOWN} more holes")
    for topic, lost in sorted(salvage.lost.items()):
        click.echo(f"  {lost} messages of {topic} are lost")
    if salvage.beginning_lost:
        click.echo("  what was before the first message kept is not known")
    if not salvage.complete:
        click.echo("  what was behind the end of the file is not known")
