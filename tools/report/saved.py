"""A figure as a file; the same figure gives the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import matplotlib as mpl
from matplotlib.figure import Figure

KINDS = ("png", "svg", "pdf")
_UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
_DPI = 150


def save(figure: Figure, file: Path | IO[bytes], kind: str) -> None:
    """Write a figure as one of `KINDS`. Raises OSError."""
    with mpl.rc_context({"svg.hashsalt": "tonus", "svg.image_inline": True}):
        figure.savefig(file, format=kind, dpi=_DPI, metadata=_UNDATED.get(kind))
