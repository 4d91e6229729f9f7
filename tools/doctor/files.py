"""Reading what the kernel says of itself, where it says it."""

from __future__ import annotations

from pathlib import Path


def read(path: str | Path) -> str | None:
    """The text of a small file without its line end; None where there is none to be read."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
