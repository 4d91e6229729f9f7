"""Rows on the disk: a journal while a study runs, and the table that comes of it."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.campaign.journal import Journal
from tonus.tools.draft import drafted
from tonus.tools.errors import ToolError
from tonus.tools.study.play import SECONDS, Row, figures
from tonus.tools.study.trials import trials

JOURNAL = "trials.jsonl"
TABLE = "trials.parquet"
ANEW = "move it away to begin anew"
_BEFORE = ("index", "config", "scenario", "controller", "seed")
_AFTER = ("verdict", "reason", "ticks", "digest", "configuration", "command")


def flat(study: ParameterStudy, row: Row) -> dict[str, Any]:
    """A row as the table has it: each parameter a column, no time of this host."""
    found = {key: row[key] for key in _BEFORE}
    found |= {key: _cell(row["parameters"][key]) for key in study.parameters}
    found |= {key: row[key] for key in figures(study)}
    return found | {key: row[key] for key in _AFTER} | {"version": version("tonus")}


def _cell(value: Any) -> Any:
    """Lists and mappings as JSON: a column has one type."""
    return json.dumps(value) if isinstance(value, list | tuple | dict) else value


def write_table(study: ParameterStudy, rows: Sequence[Row], folder: Path) -> Path:
    """The rows by index as Parquet; without pyarrow as CSV. The bytes depend on the rows only."""
    flattened = [flat(study, row) for row in rows]
    try:
        pyarrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        path = folder / "trials.csv"
        with drafted(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(flattened[0]) if flattened else _BEFORE)
            writer.writeheader()
            writer.writerows(flattened)
        return path
    path = folder / TABLE
    columns = {}
    for key in flattened[0] if flattened else ():
        values = [each[key] for each in flattened]
        if len({type(each) for each in values if each is not None} - {int, float}) and any(
            not isinstance(each, str | None) for each in values
        ):
            values = [None if each is None else str(each) for each in values]
        elif any(isinstance(each, float) for each in values):
            values = [None if each is None else float(each) for each in values]
        kind = pyarrow.float64() if key in figures(study) else None
        columns[key] = pyarrow.array(values, type=kind)
    with drafted(path) as beside:
        parquet.write_table(pyarrow.table(columns), beside)
    return path


def merged(folders: Sequence[Path]) -> tuple[ParameterStudy, list[Row]]:
    """The rows of shares of one study, each once. Raises `ToolError` where they are not of one
    study, or a trial is missing."""
    found: dict[int, Row] = {}
    first: dict[str, Any] | None = None
    for folder in folders:
        path = folder / JOURNAL
        try:
            with path.open(encoding="utf-8") as file:
                theirs = json.loads(file.readline())
            study = ParameterStudy.model_validate(theirs["study"])
        except (OSError, ValueError, KeyError) as error:
            problem = f"{path}: is no journal of a study; name the --out of a share"
            raise ToolError(problem) from error
        if first is not None and theirs != first:
            other = ", ".join(key for key in first if theirs.get(key) != first[key])
            raise ToolError(
                f"{path}: has another {other} than {folders[0]}; merge shares of one study"
            )
        first = theirs
        with Journal(folder, theirs, resume=True, name=JOURNAL, anew=ANEW) as journal:
            found |= journal.rows
    missing = [each.index for each in trials(study) if each.index not in found]
    if missing:
        raise ToolError(
            f"{len(missing)} of {len(trials(study))} trials have no row, the first is number "
            f"{missing[0]}: play the missing shares, or go on with an interrupted one"
        )
    return study, [found[index] for index in sorted(found)]


def seconds(rows: Sequence[Row]) -> float:
    """s of wall time that the trials took, one after the other."""
    return float(sum(row.get(SECONDS, 0.0) for row in rows))
