"""The documentation holds together: every link and anchor leads somewhere, and the site builds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
_OUTSIDE = ("https:", "http:", "mailto:")


def blocks(text: str) -> list[Token]:
    return MarkdownIt().enable("table").parse(text)


def anchors(text: str) -> set[str]:
    """Of the headings, as GitHub makes them; the second of a kind gets -1."""
    found: set[str] = set()
    tokens = blocks(text)
    for opening, inline in pairwise(tokens):
        if opening.type != "heading_open":
            continue
        words = "".join(part.content for part in inline.children or ())
        slug = re.sub(r"[^\w\- ]", "", words.lower()).strip().replace(" ", "-")
        number = 0
        while (name := f"{slug}-{number}" if number else slug) in found:
            number += 1
        found.add(name)
    return found


def targets(text: str) -> list[str]:
    """Of links and pictures outside of code."""
    found = []
    for token in blocks(text):
        for part in token.children or ():
            target = part.attrs.get("href", part.attrs.get("src"))
            if target is not None:
                found.append(str(target))
    return found


@cache
def _anchors_of(page: Path) -> set[str]:
    return anchors(page.read_text(encoding="utf-8"))


def dead(page: Path, text: str) -> list[str]:
    """The targets on a page that lead nowhere."""
    found = []
    for target in targets(text):
        if target.startswith(_OUTSIDE):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        if not file.exists() or (anchor and anchor not in _anchors_of(file)):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    assert not dead(page, page.read_text(encoding="utf-8"))


def test_a_dead_link_would_be_found() -> None:
    page = ROOT / "docs" / "fmea.md"
    text = "[a](stop.md) [b](stop.md#three-modes) [c](stop.md#four-modes) [d](gone.md) ![e](no.png)"
    assert dead(page, text) == ["stop.md#four-modes", "gone.md", "no.png"]
    assert dead(page, "`[a](gone.md)`\n\n    [a](gone.md)\n") == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.stem)
def test_a_page_begins_with_whom_it_is_for(page: Path) -> None:
    title, first = page.read_text().split("\n\n")[:2]
    assert title.startswith("# ")
    assert first.startswith("For ")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_source_file_that_a_page_names_is_there(page: Path) -> None:
    named = re.findall(
        r"`((?:config|docs|drivers|runtime|sim|tests|tools)/[\w./-]+)`", page.read_text()
    )
    assert [name for name in named if not (ROOT / name).exists()] == []


class Page(HTMLParser):
    """The text of a page outside of code, headings and navigation."""

    SKIPPED = frozenset(("pre", "code", "script", "style", "nav", "h1", "h2", "h3", "h4"))

    def __init__(self) -> None:
        super().__init__()
        self.inside = 0
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.inside += tag in self.SKIPPED

    def handle_endtag(self, tag: str) -> None:
        self.inside -= tag in self.SKIPPED

    def handle_data(self, data: str) -> None:
        if not self.inside:
            self.text += data


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a warning is an error. (With --quiet it would be none.)"""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    done = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stdout + done.stderr
    return folder


def test_the_site_has_every_page(site: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT / "docs").with_suffix(".html")).is_file(), page


def test_a_page_needs_no_other_host(site: Path) -> None:
    """But for what draws the diagram of the states, whose source is shown without it."""
    for path in site.rglob("*.html"):
        loaded = re.findall(
            r"<(?:script|link|img)[^>]+(?:src|href)=\"?(?:https?:)?//[^\" >]+", path.read_text()
        )
        assert not loaded, f"{path.name}: {loaded[0]}"


def test_no_table_or_list_of_the_site_is_left_as_text(site: Path) -> None:
    """What GitHub takes for one may be a paragraph to the site's reader of Markdown."""
    for path in site.rglob("*.html"):
        page = Page()
        page.feed(path.read_text(encoding="utf-8"))
        left = re.findall(r"^(?:[-*] |\d+\. |\|.*\|$|```).*$", page.text, re.MULTILINE)
        assert not left, f"{path.name}: {left[:3]}"
