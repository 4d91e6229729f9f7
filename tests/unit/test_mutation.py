"""The mutants themselves: what is changed, what is left alone, and that a good test kills them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.mutation.mutants import mutants

pytestmark = pytest.mark.wide

ROOT = Path(__file__).parents[2]
HERE = ROOT / "tests/mutation"
SOURCE = '''
"""A text."""
LIMIT = 3.0


def within(values: list[float], low: float = 1.0) -> bool:
    """Another text."""
    count = 0
    for value in values:
        if value < low and value > 0.5 * LIMIT:
            count += 1
    return min(values) >= low or not count
'''


def test_each_sort_of_error_is_made_once() -> None:
    found = [(each.was, each.now) for each in mutants(SOURCE)]
    assert len(set(found)) == len(found)
    head = "if value < low and value > 0.5 * LIMIT:"
    for now in (
        "if True:",
        "if False:",
        "if value < low or value > 0.5 * LIMIT:",
        "if value > 0.5 * LIMIT:",
        "if value < low:",
        "if value <= low and value > 0.5 * LIMIT:",
        "if value < low and value >= 0.5 * LIMIT:",
        "if value < low and value > 0.5 / LIMIT:",
        "if value < low and value > 1.5 * LIMIT:",
    ):
        assert (head, now) in found
    assert ("count += 1", "") in found
    assert (
        "return min(values) >= low or not count",
        "return max(values) >= low or not count",
    ) in found
    assert not any("text" in was or was.startswith("LIMIT") for was, _ in found)


def test_a_mutant_is_the_whole_file_with_one_change() -> None:
    unchanged = ast.unparse(ast.parse(SOURCE)).splitlines()
    for each in mutants(SOURCE):
        changed = ast.unparse(each.tree).splitlines()
        differ = [a for a, b in zip(unchanged, changed, strict=False) if a != b]
        assert differ, each.key
        assert len(changed) >= len(unchanged) - 1


def test_a_sample_of_the_judge_is_killed() -> None:
    """In a process of its own: here the supervisor has been imported already."""
    file = "runtime/supervisor/judge.py"
    words = ["-m", "tests.mutation", "--file", file, "--sample", "3", "--seed", "3"]
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{file}: 3 mutants" in done.stdout
    assert "0 survived" in done.stdout
    assert "-1 equivalent" not in done.stdout


def test_every_file_of_the_plan_has_its_tests() -> None:
    plan = yaml.safe_load((HERE / "plan.yaml").read_text())
    for file, tests in plan.items():
        assert (ROOT / file).is_file()
        assert all((ROOT / test).is_file() for test in tests)
    assert set(yaml.safe_load((HERE / "equivalent.yaml").read_text())) <= set(plan)
    ours = {str(p.relative_to(ROOT)) for p in (ROOT / "runtime/supervisor").glob("*.py")}
    assert ours - {"runtime/supervisor/__init__.py"} <= set(plan)


def test_every_equivalent_mutant_is_there() -> None:
    for file, explained in yaml.safe_load((HERE / "equivalent.yaml").read_text()).items():
        keys = {each.key for each in mutants((ROOT / file).read_text())}
        assert set(explained) <= keys
