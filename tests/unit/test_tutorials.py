"""Every tutorial is played: its files are written, its edits made, its commands run.

`make test` plays one in a short form, `make test-wide` the others: a run is shortened and brought
up quickly, without frames where the page has a bus, and left out where no later command reads its
log; of tests those that pass are left out. `make test-long` plays what stands there. Each command
must print what the page shows, but for the numbers. A block that begins a line with `$` holds
commands and what they print; `...` stands for lines that are left out. A title names the file that
a block is, or edits.
"""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import pytest
from loop import QUICK
from markdown_it import MarkdownIt

from tests.command import command
from tests.foreign import pytest_in

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
SHORTEST = "first_run"
SHORT = ["--duration", "0.1", *(f"--set={key}={value}" for key, value in QUICK.items())]
SHORT_DESIGN = ["--evaluations", "160"]
WITHOUT_FRAMES = {"config/can.yaml": "config/direct.yaml", "mine/robot.yaml": "mine/direct.yaml"}
"""for a run: without a bus it takes half the time"""
NOT_HERE = ("make ", "source ", "export PYTHONPATH=")
"""commands that this test leaves out: it runs in the environment that they make"""


class Block(NamedTuple):
    language: str
    title: str
    text: str


@dataclass
class Command:
    line: str
    shown: list[str] = field(default_factory=list)
    code: int = 0


def steps(page: Path) -> list[Block | Command]:
    """Files, edits and commands, in the order of the page."""
    found: list[Block | Command] = []
    for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
        if token.type == "fence":
            language, _, options = token.info.partition(" ")
            title = re.search(r'title="(.+?)"', options)
            if title:
                found.append(Block(language, title[1], token.content))
            elif language == "console":
                found += commands(token.content)
    return found


def commands(text: str) -> list[Command]:
    found: list[Command] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append(Command(line[2:]))
        elif ended := re.fullmatch(r"\(exit code (\d)\)", line):
            found[-1].code = int(ended[1])
        elif line.strip() not in ("", "..."):
            found[-1].shown.append(line)
    return found


def edited(before: str, diff: str) -> str:
    """The text after its lines with `-` became those with `+`; each must be there once."""
    old = [line[1:] for line in diff.splitlines() if line.startswith("-")]
    new = [line[1:] for line in diff.splitlines() if line.startswith("+")]
    assert len(old) == len(new)
    lines = before.splitlines()
    for was, becomes in zip(old, new, strict=True):
        assert lines.count(was) == 1, f"{was!r} is there {lines.count(was)} times"
        lines[lines.index(was)] = becomes
    return "\n".join(lines) + "\n"


def is_run(command: Command) -> bool:
    """Whether it is a run that ends well; one that is refused is short as it is."""
    return command.line.startswith("tonus run ") and not command.code


def is_good_test(command: Command) -> bool:
    """Whether it is a test that passes; `test_wheel.py` has others like it."""
    return command.line.startswith("python -m pytest ") and not command.code


def printed(step: Command, folder: Path, *, whole: bool) -> tuple[str, int]:
    """What a command prints, and its exit code."""
    words = shlex.split(step.line)
    if words[:3] == ["python", "-m", "pytest"]:
        return pytest_in(folder, *words[3:])
    if words[0] == "python":
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            runpy.run_path(words[1], run_name="__main__")
        return out.getvalue(), 0
    assert words[0] == "tonus", step.line
    if is_run(step) and not whole:
        words = [WITHOUT_FRAMES.get(word, word) for word in words] + SHORT
    elif words[1] == "tune" and not whole:
        words = words + SHORT_DESIGN
    done = command(*words[1:])
    return done.out + done.err, done.code


def shape(line: str) -> str:
    """A line without what differs from run to run: numbers, dates, the room they take, and the
    minutes that pytest adds after a minute."""
    line = re.sub(r"(in [\d.]+s) \([\d:]+\)$", r"\1", line.rstrip())
    return re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d.:-]*", "#", line)).strip()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The reader's working directory, which is on the import path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    yield tmp_path
    for file in tmp_path.glob("*.py"):
        sys.modules.pop(file.stem, None)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=() if page.stem == SHORTEST else pytest.mark.wide)
        for page in TUTORIALS
    ],
    ids=lambda page: page.stem,
)
@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_tutorial_does_what_it_says(page: Path, folder: Path, *, whole: bool) -> None:
    todo = steps(page)
    for number, step in enumerate(todo, start=1):
        if isinstance(step, Block):
            path = folder / step.title
            is_edit = step.language == "diff"
            path.write_text(edited(path.read_text(), step.text) if is_edit else step.text)
        elif not step.line.startswith(NOT_HERE):
            later = [each.line for each in todo[number:] if isinstance(each, Command)]
            read = any("run.mcap" in line for line in later)
            if whole or read or not (is_run(step) or is_good_test(step)):
                text, code = printed(step, folder, whole=whole)
                _compare(step, text, code, lines=whole or not is_run(step))


def _compare(command: Command, text: str, code: int, *, lines: bool = True) -> None:
    assert code == command.code, f"{command.line}: exit code {code}\n{text}"
    there = [shape(line) for line in text.splitlines()]
    for line in command.shown if lines else ():
        assert shape(line) in there, f"{command.line}: does not print {line!r} but\n{text}"


def test_a_line_that_is_not_printed_is_found() -> None:
    (command,) = commands("$ tonus check config/x.yaml\nall 3 checks passed\n(exit code 1)\n")
    _compare(command, "all 42 checks passed\n", 1)
    with pytest.raises(AssertionError, match="does not print"):
        _compare(command, "2 of 42 checks failed\n", 1)
    with pytest.raises(AssertionError, match="exit code 0"):
        _compare(command, "all 42 checks passed\n", 0)


def test_an_edit_of_a_line_that_is_not_there_is_found() -> None:
    assert edited("a: 1\nb: 2\n", "-a: 1\n+a: 3\n") == "a: 3\nb: 2\n"
    with pytest.raises(AssertionError, match="0 times"):
        edited("a: 1\n", "-a: 2\n+a: 3\n")


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_the_end_of_a_run_is_shown_whole(page: Path) -> None:
    """With the command that shows the run again, which is easily left out of a page."""
    for step in steps(page):
        if isinstance(step, Command) and is_run(step):
            for number, line in enumerate(step.shown):
                if re.match(r"  files +run\.mcap", line):
                    folder = step.shown[number - 1].split()[-1]
                    again = f"  {'see it again':<15} tonus view {folder}/run.mcap"
                    assert step.shown[number + 1] == again, step.line


def test_every_page_of_the_tutorials_is_played() -> None:
    brought = ("robot", "drive", "fieldbus", "controller", "hil_test", "log")
    assert {page.stem for page in TUTORIALS} == {"first_run", *(f"your_{each}" for each in brought)}
    for page in TUTORIALS:
        assert any(isinstance(step, Command) for step in steps(page))
