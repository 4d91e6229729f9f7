"""One test: its settings, its folders, its runs, and what is told of it when it fails."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tonus.config import Config, load
from tonus.runtime.states import State
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.expect import ExpectationError, Run
from tonus.tools.expect.failure import SHOWN
from tonus.tools.testing.arguments import mapping, named, seed

if TYPE_CHECKING:
    from tonus.tools.testing.lab import VirtualLab

__tracebackhide__ = methodcaller("errisinstance", ExpectationError)
"""For pytest, as in `tonus.tools.expect.run`."""
_IN_MEMORY = Path("/dev/shm")  # noqa: S108  # the folder made in it is this test's alone
_PRODUCTS = ("run*.mcap", "summary*.json", "report*.html")


class Measure(NamedTuple):
    """A figure that a test records."""

    name: str
    value: float
    unit: str
    at_most: float | None


class Case:
    """Made for each test that uses a fixture of the plugin, and closed after it; and for the runs
    that the tests of a file share."""

    def __init__(
        self,
        nodeid: str,
        *,
        file: Path,
        root: Path,
        invoked: Path,
        out: Path,
        config: str | Path,
        overrides: dict[str, Any],
        seed: int,
        options: Sequence[str] = (),
    ) -> None:
        """``file`` of the test, ``root`` of the project, ``invoked``: where pytest was started,
        with these ``options`` of the plugin. What is kept goes below ``out``."""
        self.nodeid, self.seed, self.overrides = nodeid, seed, overrides
        self._file, self._root, self._invoked = file, root, invoked
        self._out, self.config, self._options = out, config, options
        self.runs: list[Run] = []
        """those made by this test, in order"""
        self.labs: list[VirtualLab] = []
        self.bring_up_s = self.run_s = 0.0
        """s of wall time"""
        self._measures: list[Measure] = []
        self._kept: list[tuple[str, Path]] = []
        self._kept_of = (False, 0)
        """whether of a failed test, and how many runs"""
        self.open: list[Callable[[], object]] = []
        """each ends a run that the test has not ended itself"""
        self.closing = ExitStack()
        """what ends with the test"""
        place = _IN_MEMORY if os.access(_IN_MEMORY, os.W_OK) else None
        self.runtime = Path(tempfile.mkdtemp(prefix="tonus-", dir=place))
        """the test's own runtime directory, short enough for a socket's name"""
        self._work = Path(tempfile.mkdtemp(prefix="tonus-runs-"))

    @contextmanager
    def active(self) -> Iterator[None]:
        """Whatever runs meanwhile has the runtime directory of this test."""
        before = os.environ.get("TONUS_RUNTIME_DIR")
        os.environ["TONUS_RUNTIME_DIR"] = str(self.runtime)
        try:
            yield
        finally:
            if before is None:
                os.environ.pop("TONUS_RUNTIME_DIR", None)
            else:
                os.environ["TONUS_RUNTIME_DIR"] = before

    def close(self) -> None:
        """End what the test left open; remove its folders, but not what was kept."""
        try:
            self.closing.close()
        finally:
            shutil.rmtree(self.runtime, ignore_errors=True)
            shutil.rmtree(self._work, ignore_errors=True)

    def configuration(
        self, name: str | Path | Config | None, overrides: dict[str, Any] | None
    ) -> Config:
        """The test's configuration, or another. Raises `ConfigError`, and `ToolError` for
        overrides of a configuration that is loaded already."""
        mapping("overrides", overrides)
        named("config", self.config if name is None else name, Config)
        if isinstance(name, Config):
            if overrides:
                raise ToolError("overrides need the name of a configuration, not a Config")
            return name
        changes = {**self.overrides, **(overrides or {})}
        return load(self.place(self.config if name is None else name), overrides=changes)[0]

    def seeded(self, chosen: int | None) -> int:
        """The seed that a run is given, or that of the test. Raises `ToolError`."""
        return self.seed if chosen is None else seed(chosen)

    def place(self, name: str | Path) -> str:
        """A file's path: beside the test, else in the project's root folder, else as it is, which
        may be the name of a shipped one."""
        if Path(name).suffix:
            for folder in (self._file.parent, self._root):
                if (folder / name).is_file():
                    return str(folder / name)
        return str(name)

    def folder(self) -> Path:
        """A new one for the next run."""
        return Path(tempfile.mkdtemp(prefix="run-", dir=self._work))

    def ran(self, run: Run, total_s: float, ticking_s: float) -> Run:
        """Take note of a run and of the wall time that it took: in all, and from its first tick.

        The share of the bring-up is that of the ticks before HOLD.
        """
        states = run.log["/tonus/state"]["state"]
        ready = (states >= State.HOLD).argmax() if len(states) else 0
        before = ticking_s * float(ready) / max(len(states), 1)
        self.bring_up_s += total_s - ticking_s + before
        self.run_s += ticking_s - before
        self.runs.append(run)
        return run

    def measure(self, name: str, value: float, unit: str, at_most: float | None) -> None:
        """Record a figure. Raises `AssertionError` for one above its bound."""
        __tracebackhide__ = True
        self._measures.append(Measure(name, value, unit, at_most))
        if at_most is not None and not value <= at_most:
            raise AssertionError(f"{name} is {value:g} {unit}, and at most {at_most:g} is allowed")

    def end_runs(self) -> None:
        """End what the test left running, so that it is judged, and kept if it failed."""
        while self.open:
            self.open.pop()()

    def undisturbed(self, expected: Sequence[str]) -> None:
        """No run reported a warning or error that is not expected. Raises `ExpectationError`, and
        `ToolError` for an event that there is none of."""
        for run in self.runs:
            run.allow(*expected)
            run.undisturbed()

    def keep(self, *, failed: bool) -> list[tuple[str, Path]]:
        """Copy logs and summaries, and of a failed test the report pages, to a folder that bears
        the test's name. Gives each file's kind and path."""
        kept_of = (failed or self._kept_of[0], len(self.runs))
        if kept_of == self._kept_of or not self.runs:
            return self._kept
        self._kept, self._kept_of = [], kept_of
        from tonus.tools.report.page import report  # matplotlib: half a second for every test

        folder = self._out / _file_name(self.nodeid)
        folder.mkdir(parents=True, exist_ok=True)
        for pattern in _PRODUCTS:
            for old in folder.glob(pattern):
                old.unlink()
        for number, run in enumerate(self.runs, start=1):
            tail = "" if len(self.runs) == 1 else str(number)
            log = folder / f"run{tail}.mcap"
            shutil.copyfile(run.path, log)
            summary = folder / f"summary{tail}.json"
            write_whole(summary, json.dumps(run.summary, indent=2) + "\n")
            self._kept += [(f"log{tail}", log), (f"summary{tail}", summary)]
            if failed:
                page = folder / f"report{tail}.html"
                try:
                    report(log, page, lambda _: None)
                except ToolError:
                    continue  # a run without a tick has nothing to draw
                self._kept.append((f"report{tail}", page))
        return self._kept

    def account(self, error: BaseException | None, *, kept: bool, nodeid: str = "") -> str:
        """What a reader needs beside the failure itself: events, faults, files, the command.
        ``nodeid`` of the test that failed, where it is not this one."""
        lines: list[str] = []
        if isinstance(error, ExpectationError):
            lines.append(error.figure)
        elif self.runs and self.runs[-1].events:
            run = self.runs[-1]
            lines.append("the last events:")
            lines += run.timeline.lines(run.events, SHOWN)
        for number, run in enumerate(self.runs, start=1):
            of = "" if len(self.runs) == 1 else f" in run {number}"
            seconds = run.timeline.seconds
            struck = [f"  {seconds(each.at_ns):9.3f} s  {each.words}" for each in run.faults]
            lines += [f"faults of the lab{of}:", *struck] if struck else []
        for lab in self.labs:
            lines.append(f"a lab of seed {lab.seed}, at {lab.now:.3f} s of its time; its faults:")
            lines += [f"  {at:9.3f} s  {fault}" for at, fault in lab.given] or ["  none"]
        lines.append(f"seed {self.seed}, configuration {self.config}")
        if kept:
            lines += [f"{name}: {path}" for name, path in self._kept]
        return "\n".join([*lines, f"again: {self.command(nodeid or self.nodeid)}"])

    def command(self, nodeid: str) -> str:
        """Runs a test again, with the same result."""
        path, *rest = nodeid.split("::")
        node = "::".join([os.path.relpath(self._root / path, self._invoked), *rest])
        return shlex.join(["python", "-m", "pytest", *self._options, node])

    @property
    def measures(self) -> list[dict[str, Any]]:
        """The figures recorded, for the test's report."""
        return [each._asdict() for each in self._measures]

    def spent(self) -> tuple[float, float]:
        """s of wall time for bring-ups and for runs since this was asked last."""
        told = self.bring_up_s, self.run_s
        self.bring_up_s = self.run_s = 0.0
        return told


def _file_name(nodeid: str) -> str:
    return re.sub(r"[^\w.\[\]-]+", "-", nodeid).strip("-")
