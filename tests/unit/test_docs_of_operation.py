"""docs/operation.md and docs/commissioning.md say what the code does."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

from click.testing import CliRunner

from tonus.tools.cli.ctl import ctl
from tonus.tools.cli.run import run
from tonus.tools.report.operation import tables

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "operation.md").read_text()
COMMISSIONING = (DOCS / "commissioning.md").read_text()


def test_the_tables_are_the_ones_the_code_prints() -> None:
    assert tables() in PAGE


def test_every_ctl_command_on_the_pages_is_one() -> None:
    found = re.findall(r"^\$ tonus ctl (.+)$", PAGE, re.MULTILINE)
    found += re.findall(r"`tonus ctl ([^`|]+)`", COMMISSIONING)
    assert len(found) > 10
    for line in found:
        verb, *rest = shlex.split(line)
        assert verb in ctl.commands, line
        help_text = CliRunner().invoke(ctl, [verb, "--help"]).output
        for word in rest:
            assert not word.startswith("--") or word in help_text, line


def test_every_option_of_run_on_the_pages_is_one() -> None:
    help_text = CliRunner().invoke(run, ["--help"]).output
    for line in re.findall(r"tonus run ([^`\n]+)", PAGE + COMMISSIONING):
        for word in line.split():
            assert not word.startswith("--") or word in help_text, line


def test_the_examples_of_the_protocol_are_json() -> None:
    examples = re.findall(r"\{\"(?:op|ok)\".*?\}", PAGE)
    assert len(examples) == 4
    for example in examples:
        json.loads(example)


def test_the_program_to_ask_a_drive_is_python() -> None:
    (program,) = re.findall(r"```python\n(.*?)```", COMMISSIONING, re.DOTALL)
    compile(program, "commissioning.md", "exec")
