"""docs/faults.md says what the code does: its tables, commands, scenario and programs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from lab_bench import Bench

from tonus.config import load
from tonus.config.schema.scenario import Scenario
from tonus.sim.lab.door import Door
from tonus.tools.check.rules import check
from tonus.tools.cli.fault import fault
from tonus.tools.report.faults import tables

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "faults.md").read_text()
SESSION = re.findall(r"^\$ tonus fault (.+)\n(.+)$", PAGE, re.MULTILINE)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_tables_are_the_ones_the_schema_prints() -> None:
    assert tables() in PAGE


def test_the_sessions_commands_say_what_stands_there(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(SESSION) == 2
    with Bench() as bench:
        door = Door(bench.lab)

        def ask(request: dict[str, Any], path: Path | None) -> dict[str, Any]:
            return door.request(request)

        monkeypatch.setattr("tonus.tools.cli.fault.ask", ask)
        for command, said in SESSION:
            result = CliRunner().invoke(fault, shlex.split(command))
            assert result.exit_code == 0, result.output
            assert _timeless(result.output.strip()) == _timeless(said)


def _timeless(line: str) -> str:
    return re.sub(r"[\d.]+ s of", "T s of", line)


def test_the_scenario_is_one_and_fits_the_shipped_robot() -> None:
    (text,) = blocks("yaml")
    scenario = Scenario.model_validate(yaml.safe_load(text))
    findings = [
        each for each in check(load("config/can.yaml")[0], scenario) if each.rule == "faults"
    ]
    assert len(findings) == 3
    assert all(each.ok for each in findings)


def test_the_program_for_tests_runs() -> None:
    exec(blocks("python")[1], {})  # noqa: S102  # our own page


def test_the_program_for_the_socket_is_python() -> None:
    compile(blocks("python")[0], "faults.md", "exec")
