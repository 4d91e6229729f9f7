"""A file that appears under its name only when it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def drafted(path: Path) -> Iterator[Path]:
    """A file beside ``path`` to be written, which takes its place at the end of the block. After an
    error nothing of it remains, and what was at ``path`` before still is. Raises OSError."""
    if path.exists() and not path.is_file():
        yield path  # a pipe or a device takes what comes
        return
    beside = path.with_name(f".{path.stem}.draft{path.suffix}")
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def write_whole(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Write a text file in this way. Raises OSError."""
    with drafted(path) as beside:
        beside.write_text(text, encoding=encoding)
