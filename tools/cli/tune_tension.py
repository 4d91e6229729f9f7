"""`tonus tune tension`: the design of the tension loop, shown, written and landed."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from tonus.config import Config, load
from tonus.config.loader import load_tuning
from tonus.config.schema.control import TensionLoop
from tonus.runtime.control.controllers.linear import NoLinearLawError
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.margins.tension_loop import Margins
from tonus.tools.tune.landing import land, write
from tonus.tools.tune.tension import Design, Judged, design
from tonus.tools.tune.tuned import robot_key

_SHOWN_EVERY = 100
_UNITS = {"integral": "1/s", "rate_damping": "N m s/rad"}


def tune_tension(
    name: str,
    rules: str | None,
    evaluations: int | None,
    seed: int | None,
    out: Path | None,
    *,
    landing: bool,
    as_json: bool,
) -> None:
    """Raises `ToolError`, and `click.exceptions.Exit` with 1 where no gains keep the floors."""
    config, _ = load(name)
    given = {"evaluations": evaluations, "seed": seed}
    changes = {key: value for key, value in given.items() if value is not None}
    settings = load_tuning(rules).tension_loop.model_copy(update=changes)
    out = out or Path("out/tension.yaml")
    make_folder(out.parent)
    say = Console(stderr=True, quiet=as_json)

    def progress(done: int, best: float | None) -> None:
        if done % _SHOWN_EVERY == 0:
            found = (
                "no gains above the floors yet" if best is None else f"least error {best:.4f} N s"
            )
            say.print(f"  {done:>5} of {settings.evaluations}   {found}", highlight=False)

    try:
        found = design(config, settings, progress)
    except NoLinearLawError as error:
        raise ToolError(
            f"{config.control.controller}: its margins cannot be computed: {error}; choose another "
            "controller with --config"
        ) from error
    floors = config.control.tension_loop
    result = _provenance(config, found, settings.seed)
    write(out, result)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    else:
        _show(config, found, floors)
        click.echo(f"  written to {out}")
    for key in found.at_the_edge:
        click.echo(f"  {key} is at the end of its range; widen it with --tuning", err=as_json)
    if not found.after.meets(floors):
        click.echo(f"  {_why_not(found.after, config)}", err=as_json)
        raise click.exceptions.Exit(1)
    if landing:
        gains = {f"tension_loop.{key}": value for key, value in found.after.gains.items()}
        for file in land(name, gains):
            click.echo(f"  changed {file}", err=as_json)


def _why_not(best: Judged, config: Config) -> str:
    floors, controller = config.control.tension_loop, config.control.controller
    if not best.alone.meet(floors):
        return (
            "no gains keep the floors of the tension loop by itself; lower "
            "control.tension_loop.gain_margin_db or phase_margin_deg, or shorten "
            "control.rates.period_us"
        )
    return (
        f"no gains keep the floors of {controller} round the tension loop; lower the gains or the "
        f"stiffness of {controller}, or shorten control.rates.period_us"
    )


def _provenance(config: Config, found: Design, seed: int) -> dict[str, Any]:
    floors = config.control.tension_loop
    return {
        "robot": robot_key(config),
        "period_us": config.control.rates.period_us,
        "controller": config.control.controller,
        "seed": seed,
        "evaluations": found.evaluations,
        "floors": {"gain_db": floors.gain_margin_db, "phase_deg": floors.phase_margin_deg},
        "before": _row(found.before),
        "after": _row(found.after),
    }


def _row(judged: Judged) -> dict[str, Any]:
    return {
        "gains": judged.gains,
        "error_n_s": round(judged.cost, 6) if math.isfinite(judged.cost) else None,
        "margins": {
            name: {"gain_db": _finite(m.least_gain_db), "phase_deg": _finite(m.phase_deg)}
            for name, m in judged.margins.items()
        },
    }


def _finite(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None


def _show(config: Config, found: Design, floors: TensionLoop) -> None:
    table = Table("", "now", "designed")
    for key in found.after.gains:
        unit = f" [{_UNITS[key]}]" if key in _UNITS else ""
        now, new = (f"{each.gains[key]:g}" for each in (found.before, found.after))
        table.add_row(f"{key}{unit}".replace("[", r"\["), now, new)
    controller = config.control.controller
    named = {
        "tension loop": "tension loop by itself",
        "torque": f"{controller}, cut at the torque",
        "force": f"{controller}, cut at the force",
    }
    for cut, text in named.items():
        margins = (_margin(each.margins[cut]) for each in (found.before, found.after))
        table.add_row(text, *margins)
    table.add_row("error of the tension", _error(found.before), _error(found.after))
    Console(width=100 if not Console().is_terminal else None).print(table)
    click.echo(f"  floors {floors.gain_margin_db:g} dB and {floors.phase_margin_deg:g} deg")


def _margin(margin: Margins) -> str:
    if not margin.stable:
        return "unstable"
    return f"{margin.least_gain_db:.1f} dB, {margin.phase_deg:.1f} deg"


def _error(judged: Judged) -> str:
    return f"{judged.cost:.4f} N s" if math.isfinite(judged.cost) else "unstable"
