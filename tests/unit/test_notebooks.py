"""The notebooks of the documentation run as they stand, and their pages are printed from them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests import notebook

FIRST_LOOK = notebook.DOCS / "notebooks" / "first_look.ipynb"
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def code(path: Path) -> str:
    return "\n".join(
        notebook.source(cell) for cell in notebook.cells(path) if cell["cell_type"] == "code"
    )


def test_there_is_a_notebook() -> None:
    assert FIRST_LOOK in notebook.NOTEBOOKS


@pytest.mark.parametrize("path", notebook.NOTEBOOKS, ids=lambda path: path.stem)
def test_a_page_is_printed_from_its_notebook(path: Path) -> None:
    text, pictures = notebook.page(path)
    remedy = "python -m tests.notebook --write"
    assert path.with_suffix(".md").read_text(encoding="utf-8") == text, remedy
    for name, data in pictures.items():
        assert (path.parent / name).read_bytes() == data, remedy
    left = {each.name for each in path.parent.glob(f"{path.stem}_*.png")}
    assert left == set(pictures), remedy


@pytest.mark.parametrize("path", notebook.NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_uses_the_public_interface_only(path: Path) -> None:
    imported = set()
    for node in ast.walk(ast.parse(code(path))):
        if isinstance(node, ast.Import):
            imported |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module or "")
    assert "tonus" in imported
    assert not {name for name in imported if name.startswith("tonus.")}


@pytest.mark.parametrize("path", notebook.NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_one_for_jupyter_too(path: Path) -> None:
    """What nbformat's schema requires of the cells (version 4.5)."""
    cells = notebook.cells(path)
    assert len({cell["id"] for cell in cells}) == len(cells)
    for cell in cells:
        assert re.fullmatch(r"[\w-]{1,64}", cell["id"])
        wanted = {"cell_type", "id", "metadata", "source"}
        if cell["cell_type"] == "code":
            wanted |= {"execution_count", "outputs"}
        assert set(cell) == wanted
    counts = [cell["execution_count"] for cell in cells if cell["cell_type"] == "code"]
    assert counts == [*range(1, len(counts) + 1)]


@pytest.mark.parametrize("name", ["cable", "axis", "drum", "cell"])
def test_what_is_drawn_is_numbered_from_0_as_everywhere(name: str) -> None:
    root = notebook.DOCS.parent
    files = [*notebook.NOTEBOOKS, *notebook.DOCS.rglob("*.md"), *(root / "tools").rglob("*.py")]
    from_1 = re.compile(rf"\b{name} \{{\w+ \+ 1\}}")
    found = [str(file) for file in files if from_1.search(file.read_text(encoding="utf-8"))]
    assert not found


@pytest.mark.wide
def test_the_first_look_runs_as_it_stands(tmp_path: Path) -> None:
    shown, space = notebook.run(FIRST_LOOK, tmp_path)
    told = [_NUMBER.sub("#", each.text).split() for each in shown]
    written = [_NUMBER.sub("#", text).split() for text in notebook.texts(FIRST_LOOK)]
    assert told == written
    assert sum(len(each.pictures) for each in shown) == 3
    assert (tmp_path / "out/first_look/run.mcap").is_file()
    # What the page says about its fit.
    assert space["base"] == pytest.approx(space["law"].base, rel=0.01)
    assert space["gain"] == pytest.approx(space["law"].force_gain, rel=0.05)


def test_a_cell_shows_what_a_notebook_would(tmp_path: Path) -> None:
    path = tmp_path / "x.ipynb"
    sources = ["a = 2\nprint(a)", "a + 1", "a + 1;", "raise RuntimeError(a)"]
    listed = [
        {"cell_type": "code", "id": str(n), "metadata": {}, "source": [text], "outputs": []}
        for n, text in enumerate(sources)
    ]
    path.write_text(notebook.json.dumps({"cells": listed[:3]}))
    shown, space = notebook.run(path, tmp_path)
    assert [each.text for each in shown] == ["2\n", "3\n", ""]
    assert space["a"] == 2
    path.write_text(notebook.json.dumps({"cells": listed}))
    with pytest.raises(RuntimeError):
        notebook.run(path, tmp_path)
