"""What is wrong with a configuration: where, what, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(eq=False)
class ConfigError(Exception):
    """One broken rule: where it is broken, what was found, and the remedy.

    ``key`` is the dotted path inside the document, ``line`` counts from 1 and is 0 when unknown.
    """

    file: str
    line: int
    key: str
    problem: str
    remedy: str
    others: tuple[ConfigError, ...] = ()
    """further broken rules of the same document"""

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        key = f" {self.key}:" if self.key else ""
        # A file name or key may hold a line break; the message is one line whatever happens.
        return " ".join(f"{place}:{key} {self.problem}; {self.remedy}".split())


class PlacedError(ValueError):
    """A value at odds with another section, found where both are known; ``path`` is the value's,
    from the section whose validator found it."""

    def __init__(self, path: tuple[str | int, ...], text: str) -> None:
        super().__init__(text)
        self.path = path


def no_such(
    path: tuple[str | int, ...], what: Literal["axis", "cell"], number: int, count: int
) -> PlacedError:
    """An axis or a cell that a robot with so many of them does not have."""
    many = {"axis": "axes", "cell": "cells"}[what]
    text = f"there is no {what} {number}; {many} are numbered 0 to {count - 1}"
    return PlacedError(path, text)
