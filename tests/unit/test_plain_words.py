"""Pages, the comments of the configuration and the texts that a user reads have no idioms."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
SETTINGS = sorted((ROOT / "config").rglob("*.yaml"))
CODE = sorted(
    file
    for folder in ("config", "drivers", "runtime", "sim", "tools")
    for file in (ROOT / folder).rglob("*.py")
)
INSTEAD = {
    r"(no|some|any)body": "no node, no slave, a person",
    r"mend(s|ed|ing)?": "correct, repair",
    r"(says|said) so": "is reported",
    r"(is|are|was|were) (told|heard)": "is reported, is received",
    r"makes? of (it|them|this)": "the result, the reaction",
    r"believ(e|es|ed|ing)": "accept, use; the controller's model",
    r"insists?": "stays, repeats",
    r"forgiv(e|es|en|ing)": "tolerate",
    r"(gone )?mad|nonsense|farewell|corridors?": "the field's word",
    r"(the|this) (house|room)s?": "the project, the folder",
    r"held against": "validation, compared with",
    r"winding in|wound (on|in)": "reeling in",
}
"""what a text must not say, as regular expressions, and what it says instead"""


def refused(line: str) -> list[str]:
    """The refused words of a line, each with its remedy."""
    found = []
    for words, remedy in INSTEAD.items():
        match = re.search(rf"\b({words})\b", line, re.IGNORECASE)
        if match is not None:
            found.append(f"{match[0]!r}; write: {remedy}")
    return found


def _texts(file: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every message of a file: strings with a space that are no docstring."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    comments = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) and id(node) not in comments else None
        if isinstance(text, str) and " " in text:
            yield node.lineno, " ".join(text.split())


def _found(file: Path) -> list[str]:
    lines = (
        _texts(file)
        if file.suffix == ".py"
        else enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)
    )
    name = file.relative_to(ROOT)
    return [f"{name}:{number}: {words}" for number, line in lines for words in refused(line)]


@pytest.mark.parametrize("files", [PAGES, SETTINGS, CODE], ids=["pages", "settings", "messages"])
def test_no_text_for_a_user_has_an_idiom(files: list[Path]) -> None:
    assert files
    found = [line for file in files for line in _found(file)]
    assert not found, "\n".join(found)


def test_a_page_begins_with_its_purpose_and_its_readers() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        start = re.match(r"# [^\n]+\n\n(?:For |Control software)", text)
        assert start is not None, f"{page.relative_to(ROOT)}: say first what it is for, for whom"


def test_an_idiom_would_be_found(tmp_path: Path) -> None:
    assert refused("Mend the cause.")
    assert len(refused("Nobody answers, and the log says so.")) == 2
    assert not refused("Correct the cause: no node answers, and the event names it.")
    module = tmp_path / "module.py"
    module.write_text('"""Nobody reads it."""\nraise ValueError("mend the file")\n')
    assert [(line, bool(refused(text))) for line, text in _texts(module)] == [(2, True)]
