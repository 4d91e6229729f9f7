"""What each kind of fault is and takes, told from its class: for help texts and a lab's door."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

from tonus.config.schema.base import Section
from tonus.config.schema.faults import Fault


@dataclass(frozen=True)
class FaultField:
    """One field of a fault; bounds and choices are None where there are none."""

    name: str
    type: str
    """string, integer, number, boolean or vector: three numbers"""
    required: bool
    default: Any
    about: str
    low: float | None
    low_excluded: bool
    high: float | None
    choices: tuple[str, ...] | None

    @property
    def bounds(self) -> str:
        """Empty where any value of the type will do."""
        if self.choices is not None:
            return " | ".join(self.choices)
        if self.low is None:
            return "" if self.high is None else f"<= {self.high:g}"
        if self.low_excluded:
            return f"> {self.low:g}" + ("" if self.high is None else f", <= {self.high:g}")
        return f">= {self.low:g}" if self.high is None else f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class FaultKind:
    name: str
    about: str
    """the first paragraph of its docstring, in one line"""
    fields: tuple[FaultField, ...]
    """without ``kind`` itself; the required ones first"""

    def has(self, name: str) -> bool:
        return any(field.name == name for field in self.fields)


def _kind(model: type[Section]) -> FaultKind:
    schema = model.model_json_schema()
    name = schema["properties"].pop("kind")["const"]
    fields = sorted(_fields(schema), key=lambda field: (not field.required, field.name == "at"))
    about = schema["description"].split("\n\n")[0]
    return FaultKind(name, " ".join(about.split()), tuple(fields))


def _fields(schema: dict[str, Any]) -> Iterator[FaultField]:
    for name, described in schema["properties"].items():
        # An optional value is described as one of its type and null.
        inner = described.get("anyOf", [described])[0]
        vector = inner["type"] == "array"
        if vector:
            inner = inner["prefixItems"][0]
        yield FaultField(
            name=name,
            type="vector" if vector else inner["type"],
            required=name in schema.get("required", ()),
            default=described.get("default"),
            about=described.get("description", ""),
            low=_first(inner, "ge", "minimum", "gt", "exclusiveMinimum"),
            low_excluded="gt" in inner or "exclusiveMinimum" in inner,
            high=_first(inner, "le", "maximum"),
            choices=tuple(inner["enum"]) if "enum" in inner else None,
        )


def _first(described: dict[str, Any], *names: str) -> float | None:
    # pydantic uses its own names for a bound behind a validator and JSON Schema's elsewhere.
    return next((described[name] for name in names if name in described), None)


KINDS: dict[str, FaultKind] = {kind.name: kind for kind in map(_kind, get_args(get_args(Fault)[0]))}
"""In the order of the schema."""
