"""Mutants of one file against its tests.

Three sorts of processes, each forked from one that has imported only what is not ours: one records
which test executes which line; one imports and collects the tests once and is forked for every
mutant, which is put into it (`tests.mutation.transplant`); and one imports everything anew with the
mutant in the place of the module, for mutants of lines that run while modules are imported, and
once more for each that survived so far: only that one may say that it survived.
"""

from __future__ import annotations

import gc
import importlib.abc
import importlib.machinery
import os
import pickle
import resource
import signal
import sys
import tempfile
import types
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import pytest

from tests.mutation.interpreted import interpret
from tests.mutation.mutants import Mutant, original
from tests.mutation.recording import Recorded, record
from tests.mutation.transplant import Imported, Transplant
from tonus.tools.forked_work import Tell, forked

_OPTIONS = ["-q", "--tb=native", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist"]
_OPTIONS += ["-m", "not realtime and not wide and not long"]  # those of `make test`
_HANG_S, _HANG_TIMES, _START_S, _WAITING = 2, 3, 30, 20
"""A mutant hangs that takes so many seconds of the processor and so many times longer than the
original, or so many times these without using it."""
_ROOM = 1 << 30
"""bytes that a mutant may take beside what the original has, before it is out of memory"""
_KILLED, _SURVIVED, _ANEW = b"killed", b"survived", b"anew"


@dataclass(frozen=True)
class Verdict:
    mutant: Mutant
    killed: bool
    by: str = ""
    """test; empty for one that hung or ended the process"""


@dataclass
class Failed(Exception):  # noqa: N818
    """The tests do not pass without a mutant."""

    text: str


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


@dataclass
class Killing:
    """Of one file. ``tests`` are what pytest is given."""

    file: Path
    module: str
    tests: Sequence[str]
    workers: int = 1
    recorded: Recorded = field(default_factory=Recorded)
    _kills: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        assert self.module not in sys.modules, f"{self.module} is imported already"

    def __call__(self, todo: Sequence[Mutant]) -> Iterator[Verdict]:
        """Raises `Failed`."""
        if not todo:
            return
        self.recorded = self._record()
        quick, anew = [], []
        for mutant in todo:
            lines = range(mutant.line, mutant.last + 1)
            if self.recorded.imported.intersection(lines):
                anew.append(mutant)
            elif self.recorded.of(lines):
                quick.append(mutant)
            else:
                yield Verdict(mutant, killed=False)
        source = original(self.file.read_text())
        for verdict in self._forks([source, *quick] if quick else []):
            if verdict.mutant.line == 0:
                if verdict.killed:
                    raise Failed(f"{verdict.by or 'a test'} fails in a fork")
            elif verdict.killed:
                yield verdict
            else:
                anew.append(verdict.mutant)
        for verdict in self._imports([source, *anew] if anew else []):
            if verdict.mutant.line:
                yield verdict
            elif verdict.killed:
                raise Failed(f"{verdict.by or 'a test'} fails in a process of its own")

    def _record(self) -> Recorded:
        def work(_: int, tell: Tell) -> None:
            interpret(self.module)
            found = record(self.file, [*_OPTIONS, *self.tests])
            tell(pickle.dumps(found, 0).replace(b"\n", b"\0"))

        with _Quiet() as quiet:
            lines = [said.line for said in forked([0], 1, quiet.of(work)) if said.line is not None]
            if not lines:
                raise Failed(quiet.text)
        recorded: Recorded = pickle.loads(lines[-1].replace(b"\0", b"\n"))  # noqa: S301 - our own
        if recorded.failed:
            raise Failed(f"{recorded.failed[0]} fails")
        return recorded

    def _order(self, tests: set[str]) -> list[str]:
        """Those first that often kill, and of others the quickest."""
        cost, kills = self.recorded.seconds, self._kills
        return sorted(tests, key=lambda each: ((cost[each] + 0.02) / (kills[each] + 0.1), each))

    def _of(self, mutant: Mutant) -> list[str]:
        lines = range(mutant.line, mutant.last + 1)
        some = mutant.line and not self.recorded.imported.intersection(lines)
        return self._order(self.recorded.of(lines) if some else set(self.recorded.seconds))

    def _limit(self, tests: Sequence[str], beforehand: int = 0) -> int:
        seconds = sum(self.recorded.seconds[each] for each in tests)
        return beforehand + _HANG_S + int(_HANG_TIMES * seconds)

    def _forks(self, todo: Sequence[Mutant]) -> Iterator[Verdict]:
        if not todo:
            return

        def work(_: int, tell: Tell) -> None:
            interpret(self.module)
            pytest.main([*_OPTIONS, *self.tests], plugins=[_Server(self, todo, tell)])

        done = 0
        with _Quiet() as quiet:
            for said in forked([0], 1, quiet.of(work)):
                if said.line is not None:
                    number, what, by = said.line.split(b" ", 2)
                    done += 1
                    self._kills[by.decode()] += what == _KILLED
                    yield Verdict(todo[int(number)], what == _KILLED, by.decode())
            if done < len(todo):
                raise Failed(quiet.text)

    def _imports(self, todo: Sequence[Mutant]) -> Iterator[Verdict]:
        """Each in a process that imports everything anew."""

        def work(number: int, tell: Tell) -> None:
            chosen = self._of(todo[number])
            _bound(self._limit(chosen, _START_S))
            interpret(self.module)
            sys.meta_path.insert(0, _Source(self.module, self.file, todo[number]))
            runner = _Chosen(chosen)
            files = sorted({each.split("::")[0] for each in chosen})
            code = pytest.main([*_OPTIONS, "-x", *files], plugins=[runner])
            good = code == pytest.ExitCode.OK and runner.ran == len(chosen)
            tell(_SURVIVED if good else _KILLED + b" " + runner.failed.encode())

        found: dict[int, bytes] = {}
        with _Quiet() as quiet:
            for said in forked(range(len(todo)), self.workers, quiet.of(work)):
                if said.line is not None:
                    found[said.job] = said.line
                    continue
                what, _, by = found.get(said.job, _KILLED).partition(b" ")
                yield Verdict(todo[said.job], what == _KILLED, by.decode())


class _Server:
    """A plugin of pytest: instead of its tests it runs those of each mutant, each in a fork."""

    def __init__(self, killing: Killing, todo: Sequence[Mutant], tell: Tell) -> None:
        self._killing, self._todo, self._tell = killing, todo, tell
        self._failed = ""

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        killing, items = self._killing, {each.nodeid: each for each in session.items}
        transplant = Transplant(sys.modules[killing.module])

        def work(number: int, tell: Tell) -> None:
            chosen = killing._of(self._todo[number])
            try:
                transplant(self._todo[number])
            except Imported:
                tell(_ANEW)
                return
            _bound(killing._limit(chosen))
            for name, following in zip(chosen, [*chosen[1:], None], strict=True):
                after = None if following is None else items[following]
                items[name].config.hook.pytest_runtest_protocol(item=items[name], nextitem=after)
                if self._failed:
                    tell(_KILLED + b" " + self._failed.encode())
                    return
            tell(_SURVIVED)

        gc.freeze()
        found: dict[int, bytes] = {}
        for said in forked(range(len(self._todo)), killing.workers, work):
            if said.line is not None:
                found[said.job] = said.line
                continue
            what, _, by = found.get(said.job, _KILLED).partition(b" ")
            killing._kills[by.decode()] += what == _KILLED
            self._tell(b"%d %s %s" % (said.job, what, by))
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed = report.nodeid


class _Chosen:
    """A plugin of pytest: some tests, in an order of ours."""

    def __init__(self, chosen: Sequence[str]) -> None:
        self._place = {name: place for place, name in enumerate(chosen)}
        self.failed, self.ran = "", 0

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        place = self._place
        items[:] = sorted(
            (each for each in items if each.nodeid in place), key=lambda each: place[each.nodeid]
        )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.ran += report.when == "call" or (report.when == "setup" and report.skipped)
        if report.failed:
            self.failed = self.failed or report.nodeid


def _bound(seconds: int) -> None:
    """The time and the memory of this process."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    signal.alarm(_WAITING * seconds)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + _ROOM
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


class _Quiet:
    """What a process writes goes to a file, and is of interest if it ends without an answer."""

    def __enter__(self) -> Self:
        self._file = tempfile.TemporaryFile()
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def of(self, work: Callable[[int, Tell], None]) -> Callable[[int, Tell], None]:
        def quietly(number: int, tell: Tell) -> None:
            os.dup2(self._file.fileno(), 1)
            os.dup2(self._file.fileno(), 2)
            work(number, tell)

        return quietly

    @property
    def text(self) -> str:
        self._file.seek(0)
        return self._file.read().decode(errors="replace")[-4000:]
