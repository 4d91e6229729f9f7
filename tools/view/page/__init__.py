"""The files of the page that stands round the scene: state, operation, plots, events."""

from __future__ import annotations

from pathlib import Path

from tonus.tools.view.gate import Page

_HERE = Path(__file__).resolve().parent
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
}


def files() -> dict[str, Page]:
    """By path."""
    found = {
        f"/{file.name}": Page(_KINDS[file.suffix], file.read_bytes())
        for file in sorted(_HERE.iterdir())
        if file.suffix in _KINDS
    }
    return found | {"/": found["/index.html"]}
