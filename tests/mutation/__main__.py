"""Mutants of the safety path, and which of them its tests kill.

    python -m tests.mutation                   every file
    python -m tests.mutation --file runtime/supervisor/judge.py --sample 50
    python -m tests.mutation --write DATE      the table in docs/mutation.md
    python -m tests.mutation --again --write DATE      survivors alone, after tests were added

Exit code 1: a mutant survived that neither equivalent.yaml nor survivors.yaml explains; 2: the
tests of a file fail without a mutant.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path
from typing import Any

# What is not ours, or has no mutants, is imported once for all processes.
import can
import coverage
import hypothesis
import numba
import numpy as np
import pytest
import yaml

import tonus.config
from tests.mutation.kill import Failed, Killing
from tests.mutation.mutants import mutants
from tests.mutation.results import HERE, ROOT, Found, keep, kept, write

_IMPORTED = (can, coverage, numba, np, pytest, tonus.config)
_QUICK = hypothesis.settings(
    derandomize=True,
    database=None,
    deadline=None,
    phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
)
"""Generated inputs are the same for each mutant; which of them is the smallest does not matter."""
Reasons = dict[str, dict[str, str]]
"""by file and mutant"""


def plan() -> dict[str, dict[str, Any]]:
    """Files, the tests that have to kill their mutants, and how many are drawn where not all are
    tried."""
    found: dict[str, dict[str, Any]] = yaml.safe_load((HERE / "plan.yaml").read_text())
    return found


def reasons(name: str) -> Reasons:
    """Why no test can tell it from the original (equivalent), or none does (survivors)."""
    path = Path(HERE / f"{name}.yaml")
    found: Reasons = yaml.safe_load(path.read_text()) or {}
    return found


def examine(
    file: str,
    tests: list[str],
    sample: int | None,
    seed: int,
    workers: int,
    before: Found | None = None,
) -> Found:
    """Every mutant of a file, or some drawn at random; or those that survived ``before``."""
    begin = time.perf_counter()
    todo = list(mutants((ROOT / file).read_text()))
    found, equivalent = Found(file, mutants=len(todo)), reasons("equivalent").get(file, {})
    for name in ("equivalent", "survivors"):
        unknown = set(reasons(name).get(file, {})) - {each.key for each in todo}
        if unknown:
            raise SystemExit(f"{name}.yaml: {file}: there is no mutant {min(unknown)!r}; remove it")
    if sample is not None and sample < len(todo):
        todo = sorted(random.Random(seed).sample(todo, sample), key=lambda each: each.line)
    if before is not None:
        todo = [each for each in todo if each.key in before.survivors]
    found.tried = len(todo)
    left = [each for each in todo if each.key not in equivalent]
    found.equivalent = len(todo) - len(left)
    module = "tonus." + file.removesuffix(".py").replace("/", ".")
    lines = {}
    try:
        for verdict in Killing(ROOT / file, module, tests, workers)(left):
            found.killed += verdict.killed
            if not verdict.killed:
                lines[verdict.mutant.key] = verdict.mutant.line
    except Failed as failed:
        print(f"{file}: its tests fail without a mutant: {failed.text}", file=sys.stderr)
        raise SystemExit(2) from None
    found.survivors = sorted(lines, key=lambda key: lines[key])
    found.seconds = time.perf_counter() - begin
    if before is not None:
        found.tried, found.seconds = before.tried, before.seconds
        found.equivalent += before.equivalent
        found.killed = found.tried - found.equivalent - len(found.survivors)
    print(found.line, flush=True)
    for key in found.survivors:
        print(f"    survived, line {lines[key]}: {key}", flush=True)
    return found


def _files(name: str) -> list[Path]:
    """Of a pattern of the plan."""
    found = sorted(ROOT.glob(name))
    assert found, f"plan.yaml: there is no file {name}"
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("--file", action="append", help="only this one")
    parser.add_argument("--sample", type=int, help="so many mutants of each file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", metavar="DATE", help="the table in docs/mutation.md")
    parser.add_argument("--again", action="store_true", help="only what has survived before")
    asked = parser.parse_args()
    planned = plan()
    for file in asked.file or ():
        if file not in planned:
            parser.error(f"{file} is not in tests/mutation/plan.yaml; choose {', '.join(planned)}")
    hypothesis.settings.register_profile("mutation", _QUICK)
    hypothesis.settings.load_profile("mutation")
    tonus.config.load("config/can.yaml")  # YAML files and schemas, read once for all processes
    explained, unexplained = reasons("survivors"), 0
    for file, each in planned.items():
        if asked.file and file not in asked.file:
            continue
        sample = asked.sample or each.get("sample")
        tests = [str(path.relative_to(ROOT)) for name in each["tests"] for path in _files(name)]
        before = kept().get(file) if asked.again else None
        found = examine(file, tests, sample, asked.seed, asked.workers, before)
        unexplained += len(set(found.survivors) - set(explained.get(file, {})))
        if asked.write:
            found.date = asked.write
            results = {**kept(), file: found}
            results = {name: results[name] for name in planned if name in results}
            keep(results)
            write(results, explained)
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main())
