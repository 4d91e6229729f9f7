"""Where a schema leaves a choice between types, and what a value there may be, in words.

pydantic names the branch of such a choice in the location of an error, and reports each branch.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel, Tag
from pydantic.fields import FieldInfo

Loc = tuple[int | str, ...]
Choice = tuple[int, Any]
"""a step of a location that names a branch, and the type with the branches"""
_PLAIN = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
_BOUNDS = ((Ge, "ge", ">="), (Gt, "gt", ">"), (Le, "le", "<="), (Lt, "lt", "<"))


def choices(model: type[BaseModel], loc: Loc) -> list[Choice]:
    """The steps of a location that name a branch, as far as the schema is followed."""
    return next(_followed(model, loc, 0), [])


def _followed(kind: Any, loc: Loc, at: int) -> Iterator[list[Choice]]:
    """The choices on each way through a type; none where the location leads out of it."""
    bare, details = _bare(kind)
    if at == len(loc):
        yield []
        return
    part, arguments = loc[at], get_args(bare)
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        field = bare.model_fields.get(str(part))
        if field is not None:
            yield from _followed(whole(field), loc, at + 1)
        elif at + 1 == len(loc):
            yield []
    elif get_origin(bare) in (Union, UnionType):
        members = [each for each in arguments if each is not NoneType]
        if len(members) == 1:
            yield from _followed(members[0], loc, at)
            return
        by = _discriminator(details)
        for member in members:
            if by is None or part in _tags(member, by):
                for rest in _followed(member, loc, at + 1):
                    yield [(at, kind), *rest]
    elif get_origin(bare) is dict:
        yield from _followed(arguments[1], loc, at + 1)
    elif get_origin(bare) in (tuple, list) and isinstance(part, int):
        several = get_origin(bare) is list or arguments[-1] is Ellipsis
        if several or part < len(arguments):
            yield from _followed(arguments[0 if several else part], loc, at + 1)
    elif bare is Any or at + 1 == len(loc):
        yield []


def whole(field: FieldInfo) -> Any:
    """A field's type with what pydantic keeps beside it."""
    details = (*field.metadata, *([field] if field.discriminator is not None else []))
    return Annotated[field.annotation, *details] if details else field.annotation


def is_tagged_by_key(kind: Any) -> bool:
    """Whether a key of the mapping names the branch, as ``kind`` does; then its type is known."""
    return isinstance(_discriminator(_bare(kind)[1]), str)


def in_words(kind: Any) -> str:
    """What a value of a type may be: "a whole number >= 0 or quietest"."""
    bare, details = _bare(kind)
    arguments, origin = get_args(bare), get_origin(bare)
    if origin in (Union, UnionType):
        found = [in_words(each) for each in arguments if each is not NoneType]
        return _or(list(dict.fromkeys(found)))
    if origin is Literal:
        return _or([str(each) for each in arguments])
    if origin in (tuple, list):
        items = in_words(arguments[0]).removeprefix("a ").replace("number", "numbers", 1)
        least = next((each.min_length for each in details if isinstance(each, MinLen)), 0)
        items = "values" if arguments[0] is Any else items
        return f"a list of {f'{least} or more ' if least else ''}{items}"
    if isinstance(bare, type) and issubclass(bare, BaseModel):
        needed = [name for name, field in bare.model_fields.items() if field.is_required()]
        return f"a mapping with {', '.join(needed)}" if needed else "a mapping"
    limits = [
        f"{sign} {getattr(each, name):g}"
        for each in details
        for limit, name, sign in _BOUNDS
        if isinstance(each, limit)
    ]
    return " ".join([_PLAIN.get(bare, "a mapping"), " and ".join(limits)]).rstrip()


def _or(words: list[str]) -> str:
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last


def _bare(kind: Any) -> tuple[Any, list[Any]]:
    """A type without what is annotated, and that, of fields one by one."""
    if get_origin(kind) is not Annotated:
        return kind, []
    bare, *details = get_args(kind)
    found: list[Any] = []
    for each in details:
        found += [each, *each.metadata] if isinstance(each, FieldInfo) else [each]
    return bare, found


def _discriminator(details: list[Any]) -> Any:
    """What names a union's branch: a key, or an object with a function of the value."""
    for each in details:
        found = getattr(each, "discriminator", None)
        if found is not None:
            return found if isinstance(found, str) else getattr(found, "discriminator", found)
    return None


def _tags(member: Any, by: Any) -> list[Any]:
    bare, details = _bare(member)
    if isinstance(by, str):
        nested = _discriminator(details)
        if get_origin(bare) in (Union, UnionType):
            return [tag for each in get_args(bare) for tag in _tags(each, nested or by)]
        field = bare.model_fields.get(by)
        return list(get_args(field.annotation)) if field is not None else []
    return [each.tag for each in details if isinstance(each, Tag)]
