"""What others bring by name: an entry point, or ``package.module:Object``."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.metadata import entry_points

_OBJECT = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")


class OutsideError(Exception):
    """It cannot be had: one line that says why, and how to correct it."""


def names_object(name: str) -> bool:
    """Whether it is written as ``package.module:Object``."""
    return _OBJECT.fullmatch(name) is not None


def registered(group: str) -> list[str]:
    """Names of the entry points of a group, sorted. Nothing is imported."""
    return sorted({each.name for each in entry_points(group=group)})


def place(group: str, name: str) -> str:
    """``package.module:Object`` that the entry point of that name gives. Raises `OutsideError`."""
    found = sorted({each.value for each in entry_points(group=group, name=name)})
    if not found:
        raise OutsideError("not installed")
    if len(found) > 1:
        raise OutsideError(
            f"registered as {' and as '.join(found)}; uninstall one, or write package.module:Object"
        )
    return found[0]


def imported(group: str, name: str) -> object:
    """What a name stands for. Raises `OutsideError`."""
    module, _, path = (name if names_object(name) else place(group, name)).partition(":")
    try:
        found: object = import_module(module)
        for part in path.split("."):
            found = getattr(found, part)
    except Exception as error:  # whatever a module of somebody else's raises
        text = f"cannot be imported: {type(error).__name__}: {error}"
        raise OutsideError(text) from error
    return found
