"""Mutants of the safety path, and which of them its tests kill.

    python -m tests.mutation                   every file
    python -m tests.mutation --file runtime/supervisor/judge.py --sample 50
    python -m tests.mutation --write DATE      the table in docs/mutation.md

Exit code 1: a mutant survived that tests/mutation/equivalent.yaml does not explain.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

import tonus.sim.lab.engine
import tonus.tools.log.replay  # noqa: F401  # what the tests import anyway, before the processes part
from tests.mutation.kill import killed
from tests.mutation.mutants import Mutant, mutants, original

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs/mutation.md"
BEGIN, END = "<!-- mutation: begin -->", "<!-- mutation: end -->"


@dataclass
class Found:
    """Of one file."""

    file: str
    tried: int = 0
    killed: int = 0
    equivalent: int = 0
    survivors: list[Mutant] = field(default_factory=list)


def plan() -> dict[str, list[str]]:
    """Files and the tests that have to kill their mutants."""
    found: dict[str, list[str]] = yaml.safe_load((HERE / "plan.yaml").read_text())
    return found


def equivalents() -> dict[str, dict[str, str]]:
    """By file and mutant: why no test can tell it from the original."""
    found: dict[str, dict[str, str]] = yaml.safe_load((HERE / "equivalent.yaml").read_text())
    return found


def examine(file: str, tests: Sequence[str], sample: int | None, seed: int, workers: int) -> Found:
    """Every mutant of a file, or some drawn at random."""
    found, explained = Found(file), equivalents().get(file, {})
    todo = list(mutants((ROOT / file).read_text()))
    unknown = sorted(set(explained) - {each.key for each in todo})
    if unknown:
        raise SystemExit(f"equivalent.yaml: {file}: there is no mutant {unknown[0]!r}; remove it")
    if sample is not None and sample < len(todo):
        todo = sorted(random.Random(seed).sample(todo, sample), key=lambda each: each.line)
    found.tried = len(todo)
    left = [each for each in todo if each.key not in explained]
    found.equivalent = len(todo) - len(left)
    left.insert(0, original((ROOT / file).read_text()))
    module = "tonus." + file.removesuffix(".py").replace("/", ".")
    for mutant, dead in killed(module, ROOT / file, left, tests, workers):
        if mutant.line == 0:
            if dead:
                raise SystemExit(f"{file}: its tests fail without a mutant; correct them first")
            continue
        found.killed += dead
        if not dead:
            found.survivors.append(mutant)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("--file", action="append", help="only this one")
    parser.add_argument("--sample", type=int, help="so many mutants of each file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", metavar="DATE", help="the table in docs/mutation.md")
    asked = parser.parse_args()
    planned = plan()
    for file in asked.file or ():
        if file not in planned:
            parser.error(f"{file} is not in tests/mutation/plan.yaml; choose {', '.join(planned)}")
    results = []
    for file, tests in planned.items():
        if asked.file and file not in asked.file:
            continue
        found = examine(file, tests, asked.sample, asked.seed, asked.workers)
        results.append(found)
        print(_line(found), flush=True)
        for mutant in found.survivors:
            print(f"    survived, line {mutant.line}: {mutant.key}")
    if asked.write:
        _write(results, asked.write)
    return 1 if any(found.survivors for found in results) else 0


def _line(found: Found) -> str:
    told = f"{found.file}: {found.tried} mutants, {found.killed} killed, "
    return told + f"{found.equivalent} equivalent, {len(found.survivors)} survived"


def _write(results: Sequence[Found], date: str) -> None:
    counts = ((f"`{r.file}`", r.tried, r.killed, r.equivalent, len(r.survivors)) for r in results)
    rows = [f"| {' | '.join(map(str, each))} |" for each in counts]
    table = "\n".join(
        ["| file | mutants | killed | equivalent | survived |", "|---|---|---|---|---|", *rows]
    )
    text = PAGE.read_text()
    head, tail = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(f"{head}{BEGIN}\n\n{date}.\n\n{table}\n\n{END}{tail}")


if __name__ == "__main__":
    sys.exit(main())
