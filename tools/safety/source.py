"""All files of docs/safety, as one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from tonus.config.loader import HERE, load_section
from tonus.tools.errors import ToolError
from tonus.tools.safety.schema import Control, Failure, Hazard, Part, Requirement

Value = TypeVar("Value")
ROOT = HERE.parent
"""The source tree: tests and pages are not part of an installed Tonus."""
FOLDER = ROOT / "docs" / "safety"


@dataclass
class Evidence:
    hazards: dict[str, Hazard] = field(default_factory=dict)
    controls: dict[str, Control] = field(default_factory=dict)
    requirements: dict[str, Requirement] = field(default_factory=dict)
    failures: dict[str, list[Failure]] = field(default_factory=dict)
    """by part"""
    safety_path: list[str] = field(default_factory=list)
    """names of files of tests"""

    @property
    def rows(self) -> Iterator[Failure]:
        for rows in self.failures.values():
            yield from rows

    @property
    def situations(self) -> dict[str, str]:
        return {
            name: text
            for hazard in self.hazards.values()
            for name, text in hazard.situations.items()
        }


def load_evidence(folder: Path = FOLDER) -> Evidence:
    """Read every ``*.yaml`` of a folder. Raises `ConfigError` with file and line for a file that
    is not as `tonus.tools.safety.schema` has it, and `ToolError` for an id that two files have."""
    files = sorted(folder.glob("*.yaml"))
    if not files:
        raise ToolError(f"{folder}: no file of the safety evidence; run this in the source tree")
    evidence = Evidence()
    for file in files:
        part = load_section(file, Part)
        _add(file, evidence.hazards, part.hazards)
        _add(file, evidence.controls, part.controls)
        _add(file, evidence.requirements, part.requirements)
        for name, rows in part.failures.items():
            evidence.failures.setdefault(name, []).extend(rows)
        evidence.safety_path += part.safety_path.files
    return evidence


def _add(file: Path, known: dict[str, Value], more: dict[str, Value]) -> None:
    for name, value in more.items():
        if name in known:
            raise ToolError(f"{file}: {name} is in another file already; choose the next number")
        known[name] = value
