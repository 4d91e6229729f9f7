"""The mutants themselves: what is changed, what is left alone, that a mutant is in effect wherever
its module is used, and that a good test kills it."""

from __future__ import annotations

import ast
import subprocess
import sys
import types
from pathlib import Path

import numba
import numpy as np
import pytest
import yaml

from tests.mutation.interpreted import interpret
from tests.mutation.mutants import Mutant, mutants, original
from tests.mutation.results import PAGE, Found, kept, printed
from tests.mutation.transplant import Imported, Transplant

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


def between(value: float) -> bool:
    if (
        1.0 <= value < 2.0
    ):
        return True
    return False
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
    chain = "if 1.0 <= value < 2.0:"
    for now in ("if 1.0 < value < 2.0:", "if 1.0 <= value <= 2.0:", "if 1.0 <= value >= 2.0:"):
        assert (chain, now) in found
    assert not any("text" in was or was.startswith("LIMIT") for was, _ in found)


def test_a_mutant_is_the_whole_file_with_one_change() -> None:
    unchanged = ast.unparse(ast.parse(SOURCE)).splitlines()
    assert ast.unparse(original(SOURCE).tree).splitlines() == unchanged
    for each in mutants(SOURCE):
        changed = ast.unparse(each.tree).splitlines()
        differ = [a for a, b in zip(unchanged, changed, strict=False) if a != b]
        assert differ, each.key
        assert len(changed) >= len(unchanged) - 1


def test_the_lines_of_a_mutant_are_those_of_its_statement() -> None:
    """Without the block below it: a test that is in the block alone has been in the head too."""
    lines = {(each.was, each.line, each.last) for each in mutants(SOURCE)}
    assert ("if 1.0 <= value < 2.0:", 16, 18) in lines
    assert ("if value < low and value > 0.5 * LIMIT:", 10, 10) in lines


# --- a mutant in effect --------------------------------------------------------------------------

USED = """
import functools

LIMIT = 4


def _least():
    return 1


class Range:
    low = 2

    def __init__(self):
        self.high = 3

    @property
    def width(self):
        return self.high - self.low

    @staticmethod
    def half(value):
        return value / 2

    @functools.cached_property
    def whole(self):
        return 5


class Wider(Range):
    def __init__(self):
        super().__init__()
        self.wide = 6


def above(value):
    def beyond(other):
        return other > value

    return beyond


AT_ONCE = _least()
"""


@pytest.fixture
def used(tmp_path: Path) -> types.ModuleType:
    module = types.ModuleType("used")
    module.__file__ = str(tmp_path / "used.py")
    exec(compile(USED, module.__file__, "exec"), module.__dict__)  # noqa: S102
    return module


def _mutant(was: str, now: str) -> Mutant:
    return next(each for each in mutants(USED) if (each.was, each.now) == (was, now))


def test_a_mutant_is_in_effect_for_whoever_has_imported_it(used: types.ModuleType) -> None:
    """Functions, methods, properties, what they are wrapped in, and closures made before."""
    least, above, part = used._least, used.above, used.Range()
    beyond = above(10)
    transplant = Transplant(used)
    for was, now, value, before, after in (
        ("return 1", "return 2", least, 1, 2),
        ("return self.high - self.low", "return self.high + self.low", lambda: part.width, 1, 5),
        ("return value / 2", "return value * 2", lambda: part.half(8), 4, 16),
        ("return 5", "return 6", lambda: used.Range().whole, 5, 6),
        ("return other > value", "return other >= value", lambda: beyond(10), False, True),
        ("return other > value", "return other >= value", lambda: above(9)(9), False, True),
    ):
        assert value() == before
        transplant(_mutant(was, now))
        assert value() == after
        transplant(original(USED))
        assert value() == before


def test_a_mutant_that_shows_only_when_imported_anew_is_told(used: types.ModuleType) -> None:
    """A line of a class, and one that changes what a function closes over."""
    transplant = Transplant(used)
    for was, now in (("low = 2", "low = 3"), ("super().__init__()", "")):
        with pytest.raises(Imported):
            transplant(_mutant(was, now))


def test_constants_of_another_type_are_another_function(used: types.ModuleType) -> None:
    changed = USED.replace("return 1\n", "return 1.0\n")
    transplant = Transplant(used)
    transplant(Mutant("_least", 8, 8, "", "", 1, changed, (0, 0), None))
    assert isinstance(used._least(), float)


ONE = """
from numba import njit

@njit("int64(int64)", cache=False)
def twice(x):
    return 2 * x

@njit
def aged(table):
    table[1].age = 7
"""
OTHER = """
from numba import njit

@njit
def four(x):
    return twice(twice(x))

@njit("int64(int64)")
def six(x):
    return 6 * x
"""


@pytest.mark.wide
def test_kernels_of_one_module_stay_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """And whoever calls them, in whatever module; the others are compiled."""
    monkeypatch.setattr(numba, "njit", numba.njit)
    interpret("one")
    one, other = types.ModuleType("one"), types.ModuleType("other")
    exec(ONE, one.__dict__)  # noqa: S102
    other.__dict__.update(twice=one.twice)
    exec(OTHER, other.__dict__)  # noqa: S102
    assert type(one.twice) is types.FunctionType
    assert type(other.four) is types.FunctionType
    assert type(other.six) is not types.FunctionType
    assert other.four(3) == 12
    table = np.zeros(2, [("age", "u2"), ("force", "f8")])
    one.aged(table)
    assert table["age"].tolist() == [0, 7]


# --- the plan and what was found -----------------------------------------------------------------


@pytest.mark.wide
def test_a_sample_of_the_judge_is_killed() -> None:
    file = "runtime/supervisor/judge.py"
    words = ["-m", "tests.mutation", "--file", file, "--sample", "3", "--seed", "3"]
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{file}: 3 mutants" in done.stdout
    assert "0 survived" in done.stdout
    assert "-1 equivalent" not in done.stdout


def _read(name: str) -> dict[str, dict[str, str]]:
    return yaml.safe_load((HERE / f"{name}.yaml").read_text()) or {}


def test_every_file_of_the_plan_has_its_tests() -> None:
    plan = yaml.safe_load((HERE / "plan.yaml").read_text())
    for file, each in plan.items():
        assert (ROOT / file).is_file()
        assert all(list(ROOT.glob(test)) for test in each["tests"])
    assert set(_read("equivalent")) | set(_read("survivors")) <= set(plan)
    ours = {str(p.relative_to(ROOT)) for p in (ROOT / "runtime/supervisor").glob("*.py")}
    assert ours - {"runtime/supervisor/__init__.py"} <= set(plan)


@pytest.mark.wide
def test_every_mutant_that_is_explained_is_there() -> None:
    for name in ("equivalent", "survivors"):
        for file, explained in _read(name).items():
            keys = {each.key for each in mutants((ROOT / file).read_text())}
            assert set(explained) <= keys
            assert all(explained.values())


def test_the_page_has_what_was_found() -> None:
    assert printed(kept(), _read("survivors")) in PAGE.read_text()


def test_a_share_of_a_sample_has_an_interval() -> None:
    assert Found("a.py", mutants=40, tried=40, equivalent=2, killed=38).share == "100.0 %"
    assert Found("a.py", mutants=400, tried=100, killed=95).share == "95.0 % (89 to 98 %)"
