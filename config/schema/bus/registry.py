"""The kinds of fieldbuses that others bring: an entry point, or ``package.module:Object``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import ValidatorFunctionWrapHandler
from pydantic_core import PydanticCustomError

from tonus.config.schema.bus.base import FieldbusSection
from tonus.config.schema.outside import OutsideError, imported, names_object, registered

ENTRY_POINTS = "tonus.fieldbuses"
"""the group in which an installed distribution registers its kinds"""
SHIPPED = ("canopen", "direct", "ethercat", "several")
Kind = TypeVar("Kind", bound=FieldbusSection)


def foreign(kind: str) -> object:
    """The registration of a kind that is not shipped: an object with ``schema``, a subclass of
    `FieldbusSection`, and what the other folders ask of it. Raises `OutsideError`."""
    found = imported(ENTRY_POINTS, kind)
    schema = getattr(found, "schema", None)
    if not isinstance(schema, type) or not issubclass(schema, FieldbusSection):
        raise OutsideError(f"has no schema that is a subclass of {FieldbusSection.__name__}")
    return found


def of_kind(bus: FieldbusSection, schema: type[Kind]) -> list[Kind]:
    """The parts of a bus that have this schema."""
    return [part for part in bus.parts if isinstance(part, schema)]


def or_foreign(
    *shipped: str,
) -> Callable[[Any, ValidatorFunctionWrapHandler], FieldbusSection]:
    """A validator round a union of shipped kinds: another kind is read by its own schema."""

    def read(given: Any, handler: ValidatorFunctionWrapHandler) -> FieldbusSection:
        if isinstance(given, FieldbusSection):
            return given
        kind = given.get("kind") if isinstance(given, Mapping) else None
        if not isinstance(kind, str) or kind in SHIPPED:
            read: FieldbusSection = handler(given)
            return read
        others = registered(ENTRY_POINTS)
        if kind not in others and not names_object(kind):
            known = ", ".join(repr(each) for each in (*shipped, *others))
            raise PydanticCustomError(
                "union_tag_invalid",
                "there is no {tag}",
                {
                    "discriminator": "'kind'",
                    "tag": kind,
                    "expected_tags": f"{known} or package.module:Object",
                },
            )
        try:
            schema: type[FieldbusSection] = foreign(kind).schema  # type: ignore[attr-defined]
        except OutsideError as error:
            remedy = "name a tonus.fieldbus.FieldbusKind in a module on PYTHONPATH"
            raise ValueError(f"kind {kind}: {error}; {remedy}") from error
        return schema.model_validate(given)

    return read
