"""A mutant put into a module that is imported already: its functions stay the objects that others
have, whatever they are imported or wrapped as, and get the code of the mutant."""

from __future__ import annotations

import gc
import inspect
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType

from tests.mutation.mutants import Mutant

Place = tuple[str, int]
"""qualified name and first line"""


class Imported(Exception):  # noqa: N818 - not an error
    """It shows only in a module that is imported anew."""


class Transplant:
    """Of one module, once everything that uses it has been imported."""

    def __init__(self, module: ModuleType) -> None:
        assert module.__file__ is not None
        self._file = module.__file__
        self._alive: list[FunctionType] = [
            each
            for each in gc.get_objects()
            if type(each) is FunctionType and each.__code__.co_filename == self._file
        ]

    def __call__(self, mutant: Mutant) -> None:
        """Raises `Imported` for a mutant of no function, or of one whose closure is another."""
        made = {_place(code): code for code in _functions(compile(mutant.tree, self._file, "exec"))}
        changed = 0
        for function in self._alive:
            old, new = function.__code__, made[_place(function.__code__)]
            if _same(old, new):
                continue
            try:
                function.__code__ = new
            except ValueError:
                raise Imported from None
            changed += 1
        if mutant.line and not changed:
            raise Imported


def _place(code: CodeType) -> Place:
    return code.co_qualname, code.co_firstlineno


def _functions(code: CodeType) -> Iterator[CodeType]:
    """All of them, with those inside functions; class bodies are none."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            if each.co_flags & inspect.CO_OPTIMIZED:
                yield each
            yield from _functions(each)


def _same(one: CodeType, other: CodeType) -> bool:
    """As `==`, which also compares the columns of the source."""
    if one.co_code != other.co_code or len(one.co_consts) != len(other.co_consts):
        return False
    names = ("co_names", "co_varnames", "co_freevars", "co_cellvars", "co_exceptiontable")
    if any(getattr(one, name) != getattr(other, name) for name in names):
        return False
    pairs = zip(one.co_consts, other.co_consts, strict=True)
    return all(
        _same(a, b) if isinstance(a, CodeType) and isinstance(b, CodeType) else _equal(a, b)
        for a, b in pairs
    )


def _equal(one: object, other: object) -> bool:
    """1, 1.0 and True are different constants, and so are 0.0 and -0.0."""
    return type(one) is type(other) and repr(one) == repr(other)
