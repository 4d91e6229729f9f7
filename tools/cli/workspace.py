"""`tonus workspace`: maps of what the cables can do over the workspace."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from tonus.config import Config, load
from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.folders import make_folder
from tonus.tools.workspace import Maps, compute, draw, grid

COARSEST, FINEST = 2, 41


@click.command()
@click.argument("config")
@click.option("--tilt", is_flag=True, help="Turned by the workspace's tilt as well as upright.")
@click.option(
    "--missing",
    type=click.IntRange(min=0),
    help="As if this cable (the number of its axis) were lost.",
)
@click.option(
    "--force",
    type=FiniteRange(min=0.0),
    help="N, either way on an axis; without it the envelope's contact limit.",
)
@click.option(
    "--grid",
    "points",
    type=click.IntRange(COARSEST, FINEST),
    default=11,
    show_default=True,
    help="Positions along each edge of the box.",
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("out"), show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print workspace.json and nothing else.")
def workspace(
    config: str,
    *,
    tilt: bool,
    missing: int | None,
    force: float | None,
    points: int,
    out: Path,
    as_json: bool,
) -> None:
    """Map CONFIG's workspace: wrench feasibility, wrench closure and stiffness at every pose."""
    loaded, _ = load(config)
    if missing is not None and missing >= loaded.robot.cables:
        raise click.BadParameter(
            f"there is no axis {missing}; axes are numbered 0 to {loaded.robot.cables - 1}",
            param_hint="'--missing'",
        )
    if force is None:
        force = loaded.control.envelope.contact_limit
    make_folder(out)
    at = grid(loaded, points, tilt=tilt)
    if as_json:
        maps = compute(loaded, at, force, missing=missing)
    else:
        with click.progressbar(length=len(at.positions), label=f"{len(at.positions)} poses") as bar:
            maps = compute(loaded, at, force, missing=missing, step=bar.update)
    summary = _write(loaded, maps, out)
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    else:
        _tell(maps, out)


def _write(config: Config, maps: Maps, out: Path) -> dict[str, object]:
    """workspace.json, .csv and .png."""
    summary: dict[str, object] = {
        "config": config.name,
        "poses": len(maps.at.positions),
        "missing": maps.missing,
        "maps": maps.summary(),
    }
    (out / "workspace.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    table = np.column_stack(
        [maps.at.positions, maps.at.rotations, *(one.values for one in maps.maps.values())]
    )
    head = ",".join(["x", "y", "z", "rx", "ry", "rz", *maps.maps])
    np.savetxt(out / "workspace.csv", table, fmt="%.6g", delimiter=",", header=head, comments="")
    title = f"Tonus:  {config.name}"
    if maps.missing is not None:
        title += f",  without cable {maps.missing}"
    if np.any(maps.at.rotations):
        title += ",  the worst of seven turns"
    draw(maps, title + ";  orange: not feasible", out / "workspace.png")
    return summary


def _tell(maps: Maps, out: Path) -> None:
    for name, one in maps.maps.items():
        share = "" if one.share is None else f"{100 * one.share:5.1f} % of poses"
        figures = "nowhere"
        if one.worst is not None:
            low, middle = float(np.nanmin(one.values)), float(np.nanmedian(one.values))
            figures = f"least {low:.4g}, median {middle:.4g} {one.unit}".rstrip()
            figures += f", least at {maps.at.describe(one.worst)}"
        click.echo(f"  {name:<14} {share:<16} {one.title}: {figures}")
    files = "  ".join(str(out / f"workspace.{kind}") for kind in ("png", "csv", "json"))
    click.echo(f"  {'files':<14} {files}")
