"""The page docs/configuration.md: every key of a configuration and of a scenario.

python -m tonus.tools.report.configuration > docs/configuration.md
"""

from __future__ import annotations

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario

Schema = dict[str, Any]
_HEAD = """\
# Configuration keys

For engineers who write a configuration: every key with its type, its limits, its default and its
meaning.

`tonus init DIR` writes a complete configuration with comments, and [Your
robot](tutorials/your_robot.md) changes one. A file of its own is the [configuration](#config) and
each [scenario](#scenario). Quantities are in SI units unless the key ends in another unit (`_ms`,
`_deg`). A key without a default is required. A key that is unknown, missing or outside its limits
is an error of one line with file and line number. `!include FILE` puts another file in the place of
a value; relative names start from the folder of the file they are in. Some defaults depend on
whether the configuration has a `lab:` section ([Operation](operation.md)).

This page is printed from the code (`python -m tonus.tools.report.configuration`).
"""
_LIMITS = {
    "exclusiveMinimum": "> ",
    "gt": "> ",
    "minimum": "≥ ",
    "ge": "≥ ",
    "exclusiveMaximum": "< ",
    "lt": "< ",
    "maximum": "≤ ",
    "le": "≤ ",
}
"""Of a schema; behind a validator of ours pydantic leaves its own names."""
_HEXADECIMAL = 1_000_000
"""from here on: mapping words and identities"""
_WORDS = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
}


def documented(model: type[BaseModel]) -> dict[str, str]:
    """The text behind each field of a model and of those it extends."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if not issubclass(kind, BaseModel) or kind is BaseModel:
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(body, ast.ClassDef)
        for field, text in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            ):
                found[field.target.id] = _plain(text.value.value)
    return found


def models(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """By the name that the schema has for each: the model and all that its fields hold."""
    found: dict[str, type[BaseModel]] = {}

    def walk(annotation: Any) -> None:
        known = inspect.isclass(annotation) and annotation.__name__ in found
        if inspect.isclass(annotation) and issubclass(annotation, BaseModel) and not known:
            found[annotation.__name__] = annotation
            for field in annotation.model_fields.values():
                walk(field.annotation)
        for argument in getattr(annotation, "__args__", ()):
            walk(argument)

    walk(model)
    return found


class _Page:
    def __init__(self, *roots: type[BaseModel]) -> None:
        self._sections: dict[str, Schema] = {}
        self._models: dict[str, type[BaseModel]] = {}
        for root in roots:
            schema = root.model_json_schema()
            self._sections |= schema.pop("$defs", {}) | {root.__name__: schema}
            self._models |= models(root)
        self._first = [root.__name__ for root in roots]

    def lines(self) -> Iterator[str]:
        for name in (*self._first, *sorted(set(self._sections) - set(self._first))):
            schema = self._sections[name]
            if "properties" not in schema:
                continue
            model = self._models[name]
            texts = documented(model)
            yield f"## {name}\n"
            if model.__doc__:
                yield _plain(model.__doc__) + "\n"
            yield "| key | type | default | meaning |\n|---|---|---|---|"
            for key, each in schema["properties"].items():
                default = self._default(each, required=key in schema.get("required", ()))
                yield _row(f"`{key}`", self._type(each), default, texts.get(key, ""))
            yield ""

    def _default(self, schema: Schema, *, required: bool) -> str:
        if required:
            return ""
        if "default" not in schema:
            return "none"
        value = schema["default"]
        if isinstance(value, dict) and value:
            return "of its keys"
        return f"`{json.dumps(value)}`"

    def _type(self, schema: Schema) -> str:
        if "$ref" in schema:
            name = schema["$ref"].rsplit("/", 1)[1]
            target = self._sections[name]
            if "properties" in target:
                return f"[{name}](#{name.lower()})"
            return self._type(target)
        if "const" in schema:
            return f"`{schema['const']}`"
        if "enum" in schema:
            return " or ".join(f"`{value}`" for value in schema["enum"])
        for several in ("anyOf", "oneOf", "allOf"):
            if several in schema:
                kinds = dict.fromkeys(self._type(each) for each in schema[several])
                return " or ".join(kinds)
        kind = schema.get("type")
        if kind == "array":
            return self._array(schema)
        if kind == "object":
            values = schema.get("additionalProperties")
            return f"section of {self._type(values)}" if isinstance(values, dict) else "section"
        if kind not in ("number", "integer"):
            return _WORDS.get(str(kind), str(kind or "value"))
        found = [f"{_LIMITS[name]}{_number(schema[name])}" for name in _LIMITS if name in schema]
        return " ".join(filter(None, (_WORDS[kind], ", ".join(found))))

    def _array(self, schema: Schema) -> str:
        if "prefixItems" in schema:
            kinds = dict.fromkeys(self._type(each) for each in schema["prefixItems"])
            return f"list of {len(schema['prefixItems'])}: {', '.join(kinds)}"
        low, high = schema.get("minItems"), schema.get("maxItems")
        count = f"{low} to {high} " if low and high else f"{low} or more " if low else ""
        return f"list of {count}{self._type(schema.get('items', {}))}"


def _number(value: float) -> str:
    return f"{value:#x}" if isinstance(value, int) and value >= _HEXADECIMAL else f"{value:g}"


def _plain(text: str) -> str:
    """Without the markup and the line ends of a docstring."""
    return " ".join(inspect.cleandoc(text).replace("``", "`").split())


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def markdown() -> str:
    """The page."""
    return "\n".join([_HEAD, *_Page(Config, Scenario).lines()]).rstrip() + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
