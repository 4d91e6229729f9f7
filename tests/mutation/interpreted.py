"""Kernels of one module as plain Python: a changed kernel need not be compiled, and is changed for
whoever calls it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType
from typing import Any

import numba
import numpy as np


def interpret(module: str) -> None:
    """From now on `numba.njit` leaves the functions of ``module`` as they are, and every kernel
    that calls one of them; the others are compiled. Call it before ``module`` is imported."""
    compiling: Callable[..., Any] = numba.njit
    plain: set[int] = set()

    def decorate(function: FunctionType, signatures: Any, options: dict[str, Any]) -> Any:
        called = {id(function.__globals__.get(name)) for name in _names(function.__code__)}
        if function.__module__ == module or called & plain:
            made = _with_records(function)
            plain.add(id(made))
            return made
        return compiling(*signatures, **options)(function)

    def njit(*arguments: Any, **options: Any) -> Any:
        if arguments and isinstance(arguments[0], FunctionType):
            return decorate(arguments[0], (), options)
        return lambda each: decorate(each, arguments, options)

    numba.njit = njit


def _with_records(function: FunctionType) -> Callable[..., Any]:
    """Compiled code has the fields of a structured array as attributes; NumPy has them only of a
    record array."""

    @functools.wraps(function)
    def called(*arguments: Any) -> Any:
        return function(*map(_record, arguments))

    return called


def _record(argument: Any) -> Any:
    structured = isinstance(argument, np.ndarray) and argument.dtype.names is not None
    return argument.view(np.recarray) if structured else argument


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _names(each)
