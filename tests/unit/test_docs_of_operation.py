"""docs/operation.md and docs/commissioning.md say what the code does."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

from click.testing import CliRunner

from tonus.config import load
from tonus.config.loader import load_catalogue
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


def test_the_status_shown_is_that_of_the_configuration_it_is_of() -> None:
    (shown,) = re.findall(r"\$ tonus ctl status\n(.*?)\n\$ ", PAGE, re.DOTALL)
    (path,) = re.findall(r"`tonus run (config/\S+) --serve", PAGE)
    config, _ = load(path)
    (chosen,) = re.findall(r"^to choose(.*?)^\w", shown, re.DOTALL | re.MULTILINE)
    first, *others = re.split(r",\s+", chosen.strip())
    known = [scenario.name for scenario in load_catalogue(path)]
    assert first == config.scenario
    assert others == [name for name in known if name != first]
    at = {
        "control.stiffness.velocity_gain": config.control.stiffness.velocity_gain,
        "control.stiffness.force_gain": config.control.stiffness.force_gain,
    }
    assert re.findall(r"^to set +(.*)$", shown, re.MULTILINE) == [
        f"{each.key} {at[each.key]:g} ({each.minimum:g} to {each.maximum:g})"
        for each in config.operation.tunable
    ]


def test_the_examples_of_the_protocol_are_json() -> None:
    examples = re.findall(r"\{\"(?:op|ok)\".*?\}", PAGE)
    assert len(examples) == 4
    for example in examples:
        json.loads(example)


def test_the_program_to_ask_a_drive_is_python() -> None:
    (program,) = re.findall(r"```python\n(.*?)```", COMMISSIONING, re.DOTALL)
    compile(program, "commissioning.md", "exec")
