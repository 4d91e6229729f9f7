"""The one error of this room: a configuration that cannot be used, and how to mend it."""

from __future__ import annotations

from dataclasses import dataclass


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

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        key = f" {self.key}:" if self.key else ""
        # A file name or key may hold a line break; the message is one line whatever happens.
        return " ".join(f"{place}:{key} {self.problem}; {self.remedy}".split())
