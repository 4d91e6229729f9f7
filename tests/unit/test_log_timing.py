"""Timing budgets: every line passes or fails on what the log says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import synthetic_run
from click.testing import CliRunner

from tonus.config import ConfigError
from tonus.config.loader import load_budget
from tonus.config.schema.budget import Budget
from tonus.tools.cli.log.timing import timing
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.timing import histogram, judge

TICKS = 400
RUNNING = slice(int(0.15 * TICKS), int(0.9 * TICKS))
"""HOLD and ACTIVE of a synthetic run"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(synthetic_run.record(tmp_path_factory.mktemp("log"), TICKS))


def budget(**limit: object) -> Budget:
    return Budget.model_validate({"name": "x", "states": ["HOLD", "ACTIVE"], "limits": [limit]})


def value(log: Log, signal: str, at: object) -> float:
    (line,) = judge(log, budget(signal=signal, at=at, at_most=0.0)).lines
    assert line.value is not None
    return line.value


def test_a_line_is_judged_in_the_states_of_the_budget(log: Log) -> None:
    wakeups = synthetic_run.cycles(TICKS)["timing"]["wakeup_us"][RUNNING]
    assert judge(log, budget(signal="wakeup_us", at_most=0.0)).ticks == len(wakeups)
    assert value(log, "wakeup_us", "max") == wakeups.max()
    assert value(log, "wakeup_us", 90) == pytest.approx(np.percentile(wakeups, 90))


def test_misses_count_what_was_added_in_the_judged_ticks(log: Log) -> None:
    # One at half, three at six tenths of the run, both in ACTIVE.
    assert value(log, "missed_own", "total") == 1
    assert value(log, "missed_host", "per_million") == pytest.approx(3e6 / (0.75 * TICKS), rel=0.02)


def test_a_limit_that_is_met_exactly_passes_and_one_below_fails(log: Log) -> None:
    for at_most, passed in ((1.0, True), (0.0, False)):
        judgement = judge(log, budget(signal="missed_own", at="total", at_most=at_most))
        assert judgement.passed is passed


def test_ticks_that_are_missing_from_the_log_are_a_gap(tmp_path: Path) -> None:
    rows = synthetic_run.cycles(TICKS)
    rows["timing"]["tick"][TICKS // 2 :] += 7
    held = synthetic_run.record(tmp_path, TICKS, rows=rows)
    assert value(open_log(held), "gap_ticks", "max") == 8


def test_a_virtual_log_has_no_figures_of_a_host(tmp_path: Path) -> None:
    path = synthetic_run.record(tmp_path, TICKS, metadata={"time": "virtual"})
    judgement = judge(open_log(path), load_budget("robot"))
    absent = {line.limit.signal for line in judgement.lines if line.value is None}
    assert absent == {"wakeup_us", "cycle_us"}


def test_a_log_without_such_a_state_is_an_error(log: Log) -> None:
    empty = log.between(0.0, 0.001)
    with pytest.raises(ToolError, match="no tick in HOLD, ACTIVE"):
        judge(empty, load_budget("lab"))


def test_what_lies_beyond_the_last_edge_counts_in_the_last_bin() -> None:
    counts = histogram(np.array([0.5, 1.0, 99.0]), np.array([0.0, 1.0, 2.0]))
    assert counts.tolist() == [1, 2]


def test_the_command_exits_1_over_budget_and_names_the_line(log: Log) -> None:
    found = CliRunner().invoke(timing, [str(log.path), "--json"])
    assert found.exit_code == 1
    (told,) = json.loads(found.output)
    failed = [line["signal"] for line in told["lines"] if line["passed"] is False]
    assert failed == ["missed_own", "missed_host"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{signal: wakeup_us, at: total, at_most: 1}", "a percentile or max, not at total"),
        ("{signal: missed_own, at: 99, at_most: 1}", "total or per_million, not at 99"),
        ("{signal: wakeups, at_most: 1}", "signal"),
        ("{signal: wakeup_us, at: 100, at_most: 1}", "at"),
    ],
)
def test_a_wrong_budget_is_one_line_with_its_place(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"name: mine\nstates: [HOLD]\nlimits:\n  - {text}\n")
    with pytest.raises(ConfigError, match=says) as error:
        load_budget(str(file))
    assert "mine.yaml:4" in str(error.value)
    assert "\n" not in str(error.value)
