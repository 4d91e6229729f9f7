"""Where tuned gains land: a file with their provenance, and the configuration itself."""

from __future__ import annotations

import math
import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from tonus.config import load
from tonus.config.document import read
from tonus.config.loader import locate
from tonus.config.schema.tuning import Tuning
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.tune.search import Found
from tonus.tools.tune.work import Gains

HEAD = "# Written by tonus tune. Gains, what they cost, and by what they were found.\n"


def provenance(tuning: Tuning, fingerprint: str, robot: str, found: list[Found]) -> dict[str, Any]:
    """The result as plain data: nothing in it depends on when or where it was found."""
    return {
        "robot": robot,
        "seed": tuning.seed,
        "evaluations": tuning.evaluations,
        "population": tuning.population,
        "fingerprint": fingerprint,
        "controllers": {one.controller: _row(one) for one in found},
    }


def _row(one: Found) -> dict[str, Any]:
    return {
        "gains": one.gains,
        "cost": round(one.cost, 4),
        "cost_before": None if one.before is None else round(one.before, 4),
        "evaluations": one.evaluations,
        **({"failed_in": one.failed_in} if one.failed_in else {}),
        "refused_for_margins": one.refused,
        "margins": {
            cut: {
                "gain_db": round(m.least_gain_db, 1) if math.isfinite(m.least_gain_db) else None,
                "phase_deg": round(m.phase_deg, 1) if math.isfinite(m.phase_deg) else None,
            }
            for cut, m in one.margins.items()
        },
        "scenarios": {
            part.scenario: {
                key: round(value, 7)
                for key, value in asdict(part).items()
                if isinstance(value, float)
            }
            for part in one.parts
        },
    }


def write(path: Path, result: dict[str, Any]) -> None:
    """Raises `ToolError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, HEAD + yaml.safe_dump(result, sort_keys=False))
    except OSError as error:
        raise ToolError(f"{path}: {error.strerror}; choose another with --out") from error


def land(config: str, gains: Gains) -> list[Path]:
    """Put gains where the configuration has their keys, comments and all else left as it is.
    Returns the files changed. Raises `ToolError`, with nothing changed, when a value does not stand
    in the file as ``key: number``."""
    texts: dict[Path, list[str]] = {}
    path, shown = locate(config)
    document = read(path, shown)
    for key, value in gains.items():
        name, line = document.place(("control", *key.split(".")))
        file = _file(path, name, shown)
        lines = texts.setdefault(file, file.read_text(encoding="utf-8").splitlines(keepends=True))
        last = re.escape(key.rsplit(".", 1)[1])
        new, count = re.subn(
            rf"(\b{last}:\s*)[-+.\deE]+", rf"\g<1>{_number(value)}", lines[line - 1], count=1
        )
        if not count:
            raise ToolError(f"{name}:{line}: control.{key} is not a number there")
        lines[line - 1] = new
    before = {file: file.read_text(encoding="utf-8") for file in texts}
    for file, lines in texts.items():
        file.write_text("".join(lines), encoding="utf-8")
    control = load(config)[0].control.model_dump()
    for key, value in gains.items():
        found: Any = control
        for part in key.split("."):
            found = found[part]
        if found != value:
            for file, text in before.items():
                file.write_text(text, encoding="utf-8")
            raise ToolError(f"control.{key} could not be set to {value:g}; edit it by hand")
    return [file for file, text in before.items() if file.read_text(encoding="utf-8") != text]


def _file(config: Path, name: str, shown: str) -> Path:
    """The file that a document's place names: includes are relative to the configuration."""
    return config.parent / os.path.relpath(name, Path(shown).parent)


def _number(value: float) -> str:
    text = f"{value:.10g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"
