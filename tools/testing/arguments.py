"""Arguments of the fixtures, refused in one line where they are of the wrong kind."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from tonus.tools.errors import ToolError


def number(name: str, value: object, *, above_zero: bool = False) -> float:
    """A finite one from 0 on, or above 0. Raises `ToolError`."""
    __tracebackhide__ = True
    found = real(name, value)
    if not isfinite(found) or found < 0.0 or (above_zero and found == 0.0):
        remedy = "a number above 0" if above_zero else "a number from 0 on"
        raise ToolError(f"{name}: {value} is not possible; choose {remedy}")
    return found


def real(name: str, value: object) -> float:
    """Any number. Raises `ToolError`."""
    __tracebackhide__ = True
    try:
        if isinstance(value, str):
            raise TypeError
        return float(value)  # type: ignore[arg-type]  # whatever can be one
    except (TypeError, ValueError):
        raise ToolError(f"{name}: {value!r} is no number; give one, without a unit") from None


def seed(value: object) -> int:
    """A whole number from 0 on. Raises `ToolError`."""
    __tracebackhide__ = True
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ToolError(f"seed: {value!r} is no whole number; choose one from 0 on")
    if value.__index__() < 0:
        raise ToolError(f"seed: {value} is not possible; choose a whole number from 0 on")
    return int(value.__index__())


def mapping(name: str, value: object) -> dict[str, Any]:
    """A dict; None is an empty one. Raises `ToolError`."""
    __tracebackhide__ = True
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ToolError(f"{name}: {value!r} is no dict; give keys with their values")
    return value


def sequence(name: str, value: object) -> Sequence[Any]:
    """A list or tuple. Raises `ToolError`."""
    __tracebackhide__ = True
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise ToolError(f"{name}: {value!r} is no list; put it into one")
    return value


def named(what: str, value: object, kind: type) -> Any:
    """A name, a path, or an object of a class. Raises `ToolError`."""
    __tracebackhide__ = True
    if not isinstance(value, str | Path | kind):
        raise ToolError(f"{what}: {value!r} is no name, path or {kind.__name__}; give one")
    return value
