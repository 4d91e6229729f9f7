"""What README, docs and Makefile tell people to type is there, and the benchmarks begin."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess

import click
import pytest
from click.testing import CliRunner

from tests.bench import control, process_data
from tonus.config.loader import HERE
from tonus.tools.cli.check import check
from tonus.tools.cli.main import tonus

ROOT = HERE.parent
MAKE = shutil.which("make") or "make"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_COMMAND = re.compile(r"(?:`|^\s*\$ |^    )(tonus [^`\n|]+)", re.MULTILINE)
_PLACEHOLDER = re.compile(r"\.\.\.|[A-Z]{3,}|<|\{|\[")
"""in words that stand for others"""


def told() -> list[tuple[str, str]]:
    found = []
    for page in PAGES:
        for line in _COMMAND.findall(page.read_text(encoding="utf-8")):
            text = re.split(r"\s{2,}|,\s|;| #|&", line)[0].strip(" .,`")
            if not _PLACEHOLDER.search(text):
                found.append((page.name, text))
    return sorted(set(found))


@pytest.mark.parametrize(("page", "line"), told(), ids=str)
def test_a_command_that_is_told_can_be_typed(page: str, line: str) -> None:
    check_words(page, line)


def check_words(page: str, line: str) -> None:
    """Every verb and option is known, and every argument is there."""
    words = shlex.split(line)[1:]
    command: click.Command = tonus
    context = click.Context(command, info_name="tonus")
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        try:
            _, inner, words = command.resolve_command(context, words)
        except click.UsageError as error:
            pytest.fail(f"{page}: {line}: {error.format_message()}")
        assert inner is not None
        command = inner
        context = click.Context(command, info_name=command.name, parent=context)
    if isinstance(command, click.Group) or "--help" in words:
        return  # a whole family is named
    try:
        command.make_context(command.name, words, parent=context.parent)
    except click.MissingParameter:
        assert not words, f"{page}: {line}"  # the command's name alone stands for it
    except click.UsageError as error:
        pytest.fail(f"{page}: {line}: {error.format_message()}")


def test_setup_compiles_what_the_first_command_needs() -> None:
    """By a run with frames, in virtual time, that leaves nothing behind."""
    done = subprocess.run(
        [MAKE, "--dry-run", "--always-make", "setup"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (line,) = re.findall(r"/(tonus run .+) >/dev/null", done.stdout)
    check_words("Makefile", line)
    assert line.startswith("tonus run config/can.yaml --virtual ")
    assert done.stdout.index("-delete") < done.stdout.index(line) < done.stdout.rindex("touch")


def test_there_are_commands_to_be_tried() -> None:
    assert len(told()) > 40


def test_every_target_that_is_told_is_in_the_makefile() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        name
        for page in PAGES
        for name in re.findall(r"(?:`|^    )make ([a-z-]+)", page.read_text(), re.MULTILINE)
    }
    assert named
    assert named <= targets
    for target in sorted(targets - {"setup"}):
        done = subprocess.run(
            [MAKE, "--dry-run", "--assume-old=setup", target],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        for module in re.findall(r"python -m (tests\.[a-z_.]+)", done.stdout):
            path = ROOT / module.replace(".", "/")
            assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), module


def test_the_process_data_can_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended in a traceback: a benchmark that nobody runs is one that does not run."""
    monkeypatch.setattr(process_data, "ROUNDS", 3)
    figures = process_data.process_data()
    assert len(figures) == 5
    assert all(figure.value > 0.0 for figure in figures)


def test_a_step_in_motion_can_be_measured() -> None:
    """So did this one, when a step was given one argument more."""
    assert control.active_step(seconds=0.05) > 0.0


def test_a_step_at_its_bounds_can_be_measured() -> None:
    """Its robot ended in a fault, unnoticed."""
    assert control.loaded_step(seconds=0.05) > 0.0


def test_commissioning_shows_what_the_check_prints() -> None:
    page = (ROOT / "docs/commissioning.md").read_text(encoding="utf-8")
    block = page.partition("$ tonus check config/can.yaml\n")[2].partition("```")[0]
    told = [line for line in block.splitlines() if line and line != "..."]
    printed = CliRunner().invoke(check, ["config/can.yaml"]).output.splitlines()
    assert len(told) == 5
    assert set(told) <= set(printed)


def test_after_a_change_of_a_kernel_those_that_call_it_are_compiled_anew() -> None:
    """numba asks for a change of a kernel's own file only."""

    def planned(changed: str) -> str:
        command = [MAKE, "--dry-run", f"--what-if={changed}", "setup"]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout

    assert "-delete" in planned("runtime/control/compiled.py")
    assert planned("runtime/daemon.py") == planned("README.md")
