"""`tonus tune`: the gains of every controller by the same cost, budget, optimiser and seed; and the
design of the tension loop below them."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from tonus.config import load
from tonus.config.loader import load_tuning
from tonus.config.schema.tuning import Tuning
from tonus.runtime.timing.clock import wall_seconds
from tonus.tools.cli.tune_tension import tune_tension
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.tune.landing import land, provenance, write
from tonus.tools.tune.search import Found, Search
from tonus.tools.tune.tuned import robot_key
from tonus.tools.tune.work import Evaluator

ALL, TENSION = "all", "tension"


@click.command()
@click.argument("controller")
@click.option("--config", default="config/direct.yaml", show_default=True)
@click.option("--tuning", "rules", help="Scenarios, weights and ranges; without it config's own.")
@click.option("--evaluations", type=click.IntRange(min=1), help="Instead of the file's.")
@click.option("--seed", type=click.IntRange(min=0), help="Instead of the file's.")
@click.option("--jobs", type=click.IntRange(min=1), help="Processes; without it one a core.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Gains and provenance, without it out/tuned.yaml; beside it a journal from which an "
    "interrupted run continues. For the tension loop out/tension.yaml, and no journal.",
)
@click.option("--land", "landing", is_flag=True, help="Write the gains into the configuration too.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, nothing else.")
def tune(
    controller: str,
    *,
    config: str,
    rules: str | None,
    evaluations: int | None,
    seed: int | None,
    jobs: int | None,
    out: Path | None,
    landing: bool,
    as_json: bool,
) -> None:
    """Tune CONTROLLER, or all, on the training scenarios; or design the loop of CONTROLLER tension.

    Every controller gets the same cost, the same number of simulations, the same optimiser and
    seed, and the same floor of stability margins. Nothing is changed but OUT, unless --land. Exit
    code 1, and nothing lands, where the best gains found still fail in a scenario.

    "tension" designs the tension loop, on any bus and without a lab, by its linear model: the least
    error after friction and after a change of the reference, above the floors of the margins, for
    the loop by itself and for the configured controller round it. Exit code 1, and nothing lands,
    where no gains keep the floors.
    """
    if controller == TENSION:
        if jobs is not None:
            raise ToolError("--jobs: the tension loop is designed in one process; leave it out")
        tune_tension(config, rules, evaluations, seed, out, landing=landing, as_json=as_json)
        return
    out = out or Path("out/tuned.yaml")
    tuning = _adjusted(load_tuning(rules), evaluations, seed)
    names = _chosen(tuning, controller)
    loaded, _ = load(config)
    if loaded.lab is None:
        raise ToolError(f"{config}: tuning needs a lab section to run in")
    if loaded.fieldbus.kind != "direct":
        raise ToolError(f"{config}: tuning runs without frames; give --config config/direct.yaml")
    say = Console(stderr=True, quiet=as_json)
    make_folder(out.parent)
    journal = out.with_suffix(".journal")
    processes = jobs or os.cpu_count() or 1
    evaluator = Evaluator(config, rules, tuning.seed, journal, processes)
    found = _search(config, tuning, names, evaluator, say)
    result = provenance(tuning, evaluator.fingerprint, robot_key(loaded), found)
    write(out, result)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    else:
        _tell(found)
        click.echo(f"  written to {out}")
    failed = [one for one in found if one.failed_in]
    for one in failed:
        faults = ", ".join(f"{scenario} ({fault})" for scenario, fault in one.failed_in.items())
        text = f"  {one.controller} is NOT tuned: its best gains still fail in {faults}"
        click.echo(text, err=as_json)
    if failed:
        remedy = "make the robot run with tonus run, or give other ranges with --tuning"
        landed = "; the configuration is unchanged" if landing else ""
        click.echo(f"  {remedy}{landed}", err=as_json)
        raise click.exceptions.Exit(1)
    if landing:
        gains = {key: value for one in found for key, value in one.gains.items()}
        for file in land(config, gains):
            click.echo(f"  changed {file}", err=as_json)


def _adjusted(tuning: Tuning, evaluations: int | None, seed: int | None) -> Tuning:
    changes = {"evaluations": evaluations, "seed": seed}
    given = {key: value for key, value in changes.items() if value is not None}
    return tuning.model_copy(update=given)


def _chosen(tuning: Tuning, controller: str) -> list[str]:
    names = [str(name) for name in tuning.controllers]
    if controller == ALL:
        return names
    if controller not in names:
        raise ToolError(
            f"there is nothing to tune in {controller!r}; choose all, {TENSION} or one of "
            f"{', '.join(names)}"
        )
    return [controller]


def _search(
    config: str, tuning: Tuning, names: list[str], evaluator: Evaluator, say: Console
) -> list[Found]:
    began, budget = wall_seconds(), tuning.evaluations * len(names)
    behind = 0

    def progress(name: str, done: int, best: float) -> None:
        told = f"  {name:<14} {done:>4} of {tuning.evaluations}   best {best:.3f}"
        if evaluator.simulated:
            pace = (wall_seconds() - began) / evaluator.simulated
            told += f"   {pace * (budget - behind - done) / 60.0:.0f} min left"
        say.print(told, highlight=False)

    found = []
    for name in names:
        found.append(Search(config, tuning, name, evaluator, progress).run())
        behind += tuning.evaluations
    return found


def _tell(found: list[Found]) -> None:
    table = Table(
        "controller", "gains", "cost", "before", "margins: torque", "force", "load", "refused"
    )
    for one in found:
        gains = "\n".join(f"{key} {value:g}" for key, value in one.gains.items())
        cuts = ["", "", ""]
        for place, margin in enumerate(one.margins.values()):
            decibels = (
                f"{margin.least_gain_db:.1f} dB"
                if math.isfinite(margin.least_gain_db)
                else "no limit"
            )
            cuts[place] = f"{decibels}, {margin.phase_deg:.1f}°"
        before = "below the floors" if one.before is None else f"{one.before:.3f}"
        table.add_row(one.controller, gains, f"{one.cost:.3f}", before, *cuts, str(one.refused))
    Console(width=120 if not Console().is_terminal else None).print(table)
