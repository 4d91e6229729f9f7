"""Which lines of a file each test executes, and how long it takes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import coverage
import pytest

_IMPORT = "import"


@dataclass
class Recorded:
    """Of the unchanged file."""

    seconds: dict[str, float] = field(default_factory=dict)
    """of the processor, by test that executes any line"""
    tests: dict[int, set[str]] = field(default_factory=dict)
    """by line"""
    imported: set[int] = field(default_factory=set)
    """lines that run before the first test: in the body of a class, or called from one"""
    failed: list[str] = field(default_factory=list)

    def of(self, lines: range) -> set[str]:
        return set().union(*(self.tests.get(line, set()) for line in lines))


class Recorder:
    """A plugin of pytest. What runs in a fixture of a module or session counts for all its tests,
    although it runs for the first of them alone."""

    def __init__(self, file: Path) -> None:
        self._coverage = coverage.Coverage(data_file=None, include=[str(file)], branch=False)
        self._file = str(file)
        self._users: dict[str, set[str]] = defaultdict(set)
        self.recorded = Recorded()
        self._test = _IMPORT

    def __enter__(self) -> Self:
        self._coverage.start()
        self._coverage.switch_context(_IMPORT)
        return self

    def __exit__(self, *_: object) -> None:
        self._coverage.stop()
        data = self._coverage.get_data()
        known = {str(Path(name).resolve()): name for name in data.measured_files()}
        recorded = self.recorded
        for line, contexts in data.contexts_by_lineno(known.get(self._file, self._file)).items():
            found: set[str] = set()
            for each in contexts:
                found |= self._users[each]
            recorded.tests[line] = found
            if _IMPORT in contexts:
                recorded.imported.add(line)
        reaching = set().union(*recorded.tests.values())
        recorded.seconds = {key: recorded.seconds[key] for key in reaching}

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._test = item.nodeid
        self._users[item.nodeid].add(item.nodeid)
        self._coverage.switch_context(item.nodeid)
        begin = time.process_time()
        result = yield
        self.recorded.seconds[item.nodeid] = time.process_time() - begin
        return result

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object]
    ) -> Generator[None, object, object]:
        if fixturedef.scope == "function":
            return (yield)
        self._coverage.switch_context(f"fixture {fixturedef.baseid} {fixturedef.argname}")
        result = yield
        self._coverage.switch_context(self._test)
        return result

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        for item in session.items:
            information = getattr(item, "_fixtureinfo", None)
            for name, definitions in getattr(information, "name2fixturedefs", {}).items():
                for each in definitions:
                    self._users[f"fixture {each.baseid} {name}"].add(item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.recorded.failed.append(report.nodeid)


def record(file: Path, options: Sequence[str]) -> Recorded:
    """Runs pytest with these options in this process."""
    with Recorder(file) as recorder:
        pytest.main([*options], plugins=[recorder])
    return recorder.recorded
