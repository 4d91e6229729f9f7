"""How the plant's equations are compiled, and when they are compiled anew.

The compiler's cache watches the file of the outermost function only. What it calls lies in other
files, so a digest of them all stands in the type of the parameters (`layout.parameters_dtype`), and
with it in the key under which a compiled function is found again.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def sources(folder: Path) -> str:
    """A digest of every Python file of a folder."""
    digest = sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# No fastmath: equal seeds must give equal bytes.
def inner(function: _Function) -> _Function:
    """Compile a function that only compiled functions call."""
    return cast(_Function, njit(error_model="numpy")(function))


def outermost(function: _Function) -> _Function:
    """Compile a function that Python calls, and keep the machine code for the next process."""
    try:
        return cast(_Function, njit(cache=True, error_model="numpy")(function))
    except RuntimeError:
        # Neither beside this file nor in the user's cache may anything be written: compile anew.
        return inner(function)
