"""The notebooks of the documentation: their cells are run, and their pages printed.

python -m tests.notebook --write     runs them and writes what they print and draw into them

A notebook is JSON (nbformat.readthedocs.io, 4.5), its cells are plain Python, and what they draw is
matplotlib's. So they run in this process, in one namespace: nbclient would bring a kernel, its
protocol and some twenty packages for the same.
"""

from __future__ import annotations

import argparse
import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import pyplot as plt

DOCS = Path(__file__).resolve().parents[1] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
_DPI = 80


@dataclass
class Shown:
    """What became of a cell."""

    text: str = ""
    pictures: list[bytes] = field(default_factory=list)
    """PNG"""


def cells(path: Path) -> list[dict[str, Any]]:
    """Of a notebook, in order."""
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return found


def source(cell: dict[str, Any]) -> str:
    return "".join(cell["source"])


def run(path: Path, folder: Path) -> tuple[list[Shown], dict[str, Any]]:
    """Run a notebook's code in ``folder``. Gives what each cell of code shows, and the variables
    at the end; raises what a cell raises."""
    space: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.chdir(folder), mpl.rc_context():
        mpl.use("Agg")
        shown = [_run(source(cell), space) for cell in cells(path) if cell["cell_type"] == "code"]
    return shown, space


def _run(code: str, space: dict[str, Any]) -> Shown:
    """As a notebook does it: the last expression is shown, and every figure that is open."""
    tree, out = ast.parse(code), io.StringIO()
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(out):
        exec(compile(tree, "cell", "exec"), space)  # noqa: S102  # it is ours
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), space)  # noqa: S307
            if value is not None and not code.rstrip().endswith(";"):
                print(repr(value))
    return Shown(out.getvalue(), list(_pictures()))


def _pictures() -> Iterator[bytes]:
    for number in plt.get_fignums():
        file = io.BytesIO()
        plt.figure(number).savefig(file, format="png", dpi=_DPI)
        yield file.getvalue()
    plt.close("all")


def filled(path: Path, shown: list[Shown]) -> str:
    """The notebook with what its cells show."""
    notebook, coming = json.loads(path.read_text(encoding="utf-8")), iter(shown)
    count = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        each, count = next(coming), count + 1
        cell["execution_count"] = count
        cell["outputs"] = []
        if each.text:
            lines = each.text.splitlines(keepends=True)
            cell["outputs"].append({"name": "stdout", "output_type": "stream", "text": lines})
        for picture in each.pictures:
            data = {"image/png": base64.b64encode(picture).decode()}
            cell["outputs"].append({"data": data, "metadata": {}, "output_type": "display_data"})
    return json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def texts(path: Path) -> list[str]:
    """What the cells of code of a notebook show as text, as it stands in the file."""
    return [
        "".join("".join(each["text"]) for each in cell["outputs"] if "text" in each)
        for cell in cells(path)
        if cell["cell_type"] == "code"
    ]


def page(path: Path) -> tuple[str, dict[str, bytes]]:
    """The notebook as a page of the site, beside it, and its pictures by file name."""
    parts, pictures = [], {}
    for cell in cells(path):
        if cell["cell_type"] == "markdown":
            parts.append(source(cell).strip())
            continue
        parts.append(f"```python\n{source(cell).strip()}\n```")
        for output in cell["outputs"]:
            if "text" in output:
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
                continue
            name = f"{path.stem}_{len(pictures) + 1}.png"
            pictures[name] = base64.b64decode(output["data"]["image/png"])
            parts.append(f"![The figure of the cell above]({name})")
    return "\n\n".join(parts) + "\n", pictures


def write(path: Path) -> None:
    """Run a notebook, and write it, its page and its pictures anew."""
    with tempfile.TemporaryDirectory() as folder:
        shown, _ = run(path, Path(folder))
    path.write_text(filled(path, shown), encoding="utf-8")
    text, pictures = page(path)
    path.with_suffix(".md").write_text(text, encoding="utf-8")
    for name, data in pictures.items():
        (path.parent / name).write_bytes(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="else only run them")
    options = parser.parse_args()
    for path in NOTEBOOKS:
        if options.write:
            write(path)
        else:
            with tempfile.TemporaryDirectory() as folder:
                run(path, Path(folder))
        print(os.fspath(path))


if __name__ == "__main__":
    main()
