"""One mutant against its tests, in a fork of a process that has imported everything else."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import signal
import sys
import types
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tests.mutation.mutants import Mutant
from tonus.tools.forked_work import Tell, forked

_HANG_S = 60
_KILLED, _SURVIVED = b"killed", b"survived"


class _Source(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module from a tree instead of from its file."""

    def __init__(self, module: str, file: Path, mutant: Mutant) -> None:
        self._module, self._file, self._mutant = module, file, mutant

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: types.ModuleType | None = None,
    ) -> importlib.machinery.ModuleSpec | None:
        del path, target
        if fullname != self._module:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=str(self._file))

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> None:
        del spec

    def exec_module(self, module: types.ModuleType) -> None:
        module.__file__ = str(self._file)
        exec(compile(self._mutant.tree, str(self._file), "exec"), module.__dict__)  # noqa: S102


def killed(
    module: str, file: Path, todo: Sequence[Mutant], tests: Sequence[str], workers: int
) -> Iterator[tuple[Mutant, bool]]:
    """Whether the tests fail with each mutant of ``module``, as they come. A hang is a failure."""
    assert module not in sys.modules, f"{module} is imported already, mutants would not be"

    def work(number: int, tell: Tell) -> None:
        signal.alarm(_HANG_S)
        sys.meta_path.insert(0, _Source(module, file, todo[number]))
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-n0"]
        code = pytest.main([*options, *tests])
        tell(_SURVIVED if code == pytest.ExitCode.OK else _KILLED)

    survived: set[int] = set()
    for said in forked(range(len(todo)), workers, work):
        if said.line == _SURVIVED:
            survived.add(said.job)
        elif said.line is None:
            yield todo[said.job], said.job not in survived
