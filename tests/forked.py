"""What follows from one state in several ways, each in a process of its own: a robot that has been
brought up once is forked for every case."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TypeVar

Result = TypeVar("Result")


def forked(act: Callable[[], Result]) -> Result:
    """What ``act`` returns, computed in a child with a copy of everything here, which stays as it
    is. Raises `RuntimeError` if the child failed; it has said why on standard error."""
    context = multiprocessing.get_context("fork")
    reading, writing = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(act, writing))
    child.start()
    writing.close()
    try:
        result: Result = reading.recv()
    except EOFError:
        raise RuntimeError("the child ended without an answer") from None
    finally:
        reading.close()
        child.join()
    return result


def _answer(act: Callable[[], object], writing: Connection) -> None:
    writing.send(act())
    writing.close()
