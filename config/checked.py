"""A document held against its schema, and what a person is told where it does not fit.

Apart from the loader, so that who reads one small file does not wait for the schema of all.
"""

from __future__ import annotations

import difflib
import re
import reprlib
from functools import partial
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tonus.config.alternatives import Loc, choices, in_words, is_tagged_by_key
from tonus.config.document import Document, Key, dotted
from tonus.config.errors import ConfigError, PlacedError

Model = TypeVar("Model", bound=BaseModel)

_REMEDY = {
    "missing": "add it",
    "extra_forbidden": "remove it or correct its spelling",
    "greater_than": "choose a larger value",
    "greater_than_equal": "choose a larger value",
    "less_than": "choose a smaller value",
    "less_than_equal": "choose a smaller value",
    "finite_number": "give a finite number",
    "literal_error": "choose one of these",
    "union_tag_invalid": "choose one of these",
    "union_tag_not_found": "add it",
    "too_short": "give the missing items",
    "too_long": "remove the surplus items",
    "value_error": "change one of the values",
}
_SHAPE = {
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dict_type": "a mapping",
    "tuple_type": "a list",
    "list_type": "a list",
    "string_type": "a text",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}
"""what a value of another type should be, in the words of YAML"""
_ALTERNATIVES = "alternatives"
"""the kind of an error that stands for one of each branch of a choice"""
_OF_KEY = "[key]"
_RELATION = " must hold"
_EXPECTED = "give a value of that type"


def validated(document: Document, model: type[Model]) -> Model:
    """The document as its schema has it. Raises `ConfigError`."""
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        # A misspelt key is also a missing one; its own place is the better answer.
        reported = _once_a_choice(model, error.errors())
        found = sorted(reported, key=partial(_rank, document))
        misspelt = {each["loc"][:-1] for each in found if each["type"] == "extra_forbidden"}
        explained: dict[str, ConfigError] = {}
        for each in found:
            if each["type"] == "missing" and each["loc"][:-1] in misspelt:
                continue
            one = _explain(document, model, each)
            explained.setdefault(one.key, one)
        first, *further = explained.values()
        first.others = tuple(further)
        raise first from error


def _rank(document: Document, error: ErrorDetails) -> tuple[bool, str, int]:
    """Unknown keys first, in the order of the document, which pydantic does not keep."""
    if error["type"] != "extra_forbidden":
        return True, "", 0
    return False, *document.key_place(error["loc"])


def _once_a_choice(model: type[BaseModel], errors: list[ErrorDetails]) -> list[ErrorDetails]:
    """A value that fits no branch of a choice has an error in each of them: only those of the
    branch that it is nearest to, or one that names them all."""
    found: dict[Loc, list[ErrorDetails]] = {}
    kinds: dict[Loc, Any] = {}
    for each in errors:
        if each["type"] == "too_short" and len(each["input"]) > each["ctx"]["actual_length"]:
            continue  # it counts only the items that are as they should be
        loc = each["loc"]
        start, kind = next(
            ((loc[:at], kind) for at, kind in choices(model, loc) if not is_tagged_by_key(kind)),
            (loc, None),
        )
        found.setdefault(start, []).append(each)
        if kind is not None:
            kinds[start] = kind
    chosen: list[ErrorDetails] = []
    for start, group in found.items():
        chosen += _nearest(start, kinds[start], group) if start in kinds else group
    return chosen


def _nearest(start: Loc, kind: Any, errors: list[ErrorDetails]) -> list[ErrorDetails]:
    branches: dict[int | str, list[ErrorDetails]] = {}
    for each in errors:
        branches.setdefault(each["loc"][len(start)], []).append(each)
    # An error further inside, or of the length, says that the value has the branch's shape.
    near = [
        group
        for group in branches.values()
        if any(
            len(each["loc"]) > len(start) + 1 or each["type"] in ("too_short", "too_long")
            for each in group
        )
    ]
    if near:
        return min(near, key=len)
    if len(branches) == 1 and errors[0]["type"] not in _SHAPE:
        return errors  # a value named its branch, and is of its shape
    text = f"input should be {in_words(kind)}"
    return [{"loc": start, "type": _ALTERNATIVES, "msg": text, "input": errors[0]["input"]}]


def _explain(document: Document, model: type[BaseModel], error: ErrorDetails) -> ConfigError:
    kind = error["type"]
    cause = error["ctx"]["error"] if kind == "value_error" else None
    path = cause.path if isinstance(cause, PlacedError) else ()
    branches = {at for at, _ in choices(model, error["loc"])}
    loc = tuple(part for at, part in enumerate(error["loc"]) if at not in branches)
    key = _real_key(document, (*loc, *path))
    remedy = _REMEDY.get(kind, _EXPECTED)
    problem = error["msg"].removeprefix("Value error, ")
    problem = problem[0].lower() + problem[1:]
    if kind == "missing":
        problem = "is missing"
    elif kind == "extra_forbidden":
        problem = "is not a key here"
        remedy = choose(str(key[-1]), _fields(model, key), remedy)
    elif kind == "union_tag_invalid":
        context = error["ctx"]
        key = (*key, context["discriminator"].strip("'"))
        problem = f"there is no {context['tag']!r}"
        remedy = f"choose one of {context['expected_tags']}"
    elif kind == "union_tag_not_found":
        problem = f"has no {error['ctx']['discriminator']}"
    elif kind == "value_error":
        problem, _, said = problem.partition("; ")
        remedy = said or remedy
        if problem.endswith(_RELATION):
            problem += f", not {_in_values(problem.removesuffix(_RELATION), error['input'])}"
    elif kind in ("too_short", "too_long"):
        bound = error["ctx"].get("min_length" if kind == "too_short" else "max_length")
        word = "least" if kind == "too_short" else "most"
        problem = f"has {error['ctx']['actual_length']} items, and takes at {word} {bound}"
    else:
        if kind in _SHAPE:
            problem = f"input should be {_SHAPE[kind]}"
        problem = f"{problem}, not {_in_yaml(error['input'])}"
        remedy = "write its keys below it" if _is_left_empty(error) else remedy
        if error["input"] != error["input"]:  # nan alone
            remedy = _REMEDY["finite_number"]
    of_key = kind == "extra_forbidden" or _OF_KEY in error["loc"]
    file, line = document.key_place(key) if of_key else document.place(key)
    return ConfigError(file, line, dotted(key), problem, remedy)


def _in_yaml(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    return reprlib.repr(value)


def _is_left_empty(error: ErrorDetails) -> bool:
    return error["input"] is None and _SHAPE.get(error["type"]) == "a mapping"


def _in_values(relation: str, section: Any) -> str:
    """A relation between keys of a section, with what is stated there in their place."""
    stated = section if isinstance(section, dict) else {}
    return re.sub(r"[a-z_]+", lambda name: str(stated.get(name[0], name[0])), relation)


def _real_key(document: Document, loc: tuple[int | str, ...]) -> Key:
    """pydantic marks an error of a key, and names what a validator put in; the document has no such
    steps."""
    key: list[str | int] = []
    place: Any = document.data
    for index, part in enumerate(loc):
        last = index == len(loc) - 1
        if part == _OF_KEY:
            continue
        if isinstance(place, dict):
            if part in place:
                place = place[part]
            elif not last:
                continue
        elif isinstance(place, list) and isinstance(part, int) and part < len(place):
            place = place[part]
        elif not last or (isinstance(place, list) and isinstance(part, str)):
            continue
        key.append(part)
    return tuple(key)


def _fields(model: type[BaseModel], key: Key) -> list[str]:
    """The keys that the schema knows beside the one that is unknown."""
    names: list[str] = []
    candidates: list[Any] = [model]
    for part in key[:-1]:
        inner: list[Any] = []
        for candidate in candidates:
            fields = getattr(candidate, "model_fields", {})
            if part in fields:
                inner += _models(fields[part].annotation)
            elif isinstance(part, int) or part.isdecimal():
                inner.append(candidate)
        candidates = inner
    for candidate in candidates:
        names += list(candidate.model_fields)
    return names


def _models(annotation: Any) -> list[Any]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    found: list[Any] = []
    for argument in getattr(annotation, "__args__", ()):
        found += _models(argument)
    return found


def choose(name: str, known: list[str], otherwise: str | None = None, shown: str = "{}") -> str:
    """The nearest name, else ``otherwise``, else all; each as ``shown``."""
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"did you mean {shown.format(close[0])}?"
    return otherwise or f"choose one of {', '.join(map(shown.format, known))}"
