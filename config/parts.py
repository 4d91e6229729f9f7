"""A part of a configuration that is given as a whole one: which key it belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from tonus.config.schema.place import DEFAULTS
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario

_WHOLE = frozenset({"robot", "fieldbus", "control", "tracker"})
"""keys that only a whole configuration has"""
_ENOUGH = 0.6
"""share of the keys, given or needed, that have to agree: one may be misspelt"""
_DEPTH = 2
SCENARIO = "scenario"


def part_of(data: Any) -> str | None:
    """The dotted key whose value a document is, `SCENARIO` for a scenario's; None for what has a
    key of a whole configuration, or fits nowhere."""
    if not isinstance(data, dict) or data.keys() & _WHOLE:
        return None
    known: list[tuple[str, type[BaseModel]]]
    known = [(SCENARIO, Scenario), *_parts(Config, "", _DEPTH)]
    fits = [(_agreement(data, model), key) for key, model in known]
    share, key = max(fits, key=lambda fit: (fit[0], -fit[1].count(".")))
    return key if share >= _ENOUGH else None


def _agreement(data: dict[str, Any], model: type[BaseModel]) -> float:
    fields = model.model_fields
    needed = {name for name, field in fields.items() if field.is_required()}
    # What a section leaves out that the place of a run decides, is given there.
    needed -= {key[-1] for key in DEFAULTS}
    every = data.keys() | needed
    return len(data.keys() & fields.keys()) / len(every) if every else 0.0


def _parts(model: type[BaseModel], at: str, depth: int) -> Iterator[tuple[str, type[BaseModel]]]:
    for name, field in model.model_fields.items():
        for inner in _models(field.annotation):
            yield f"{at}{name}", inner
            if depth > 1:
                yield from _parts(inner, f"{at}{name}.", depth - 1)


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
        return
    for argument in get_args(kind):
        yield from _models(argument)
