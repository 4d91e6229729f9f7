"""What a study costs beside its runs: trials that do nothing, through the local engine and through
Dask with two workers, to the table. `make bench-studies`; figures in docs/studies.md."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import click
import psutil

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.runtime.timing import clock
from tonus.tools.study import engine
from tonus.tools.study.play import FIGURES, Row, _row
from tonus.tools.study.store import JOURNAL, write_table
from tonus.tools.study.trials import Trial

_PARAMETERS = {"control.stiffness.velocity_gain": (0.0, 0.32)}


def empty(study: ParameterStudy, trial: Trial, folder: Path | None = None) -> Row:
    """A row as long as a run's, at once."""
    del folder
    figures = dict.fromkeys(FIGURES, 1.0 / 3.0)
    return _row(study, trial, "completed", "scenario completed", 20_500, "0" * 16) | figures


@dataclass(frozen=True)
class Cost:
    engine: str
    trials: int
    seconds: float
    """to the last row in the journal"""
    table_s: float
    row_bytes: float
    here_mb: float
    """largest memory of the process that writes"""
    scheduler_mb: float | None = None

    def __str__(self) -> str:
        memory = f"{self.here_mb:.0f} MB"
        if self.scheduler_mb is not None:
            memory += f", scheduler {self.scheduler_mb:.0f} MB"
        return (
            f"| {self.engine} | {self.trials} | {self.trials / self.seconds:.0f} | "
            f"{1e3 * self.seconds / self.trials:.2f} | {self.table_s:.1f} | "
            f"{self.row_bytes:.0f} | {memory} |"
        )


HEAD = (
    "| engine | trials | trials a second | ms a trial | s for the table | bytes a row | memory |\n"
    "|---|---|---|---|---|---|---|"
)


def study(trials: int) -> ParameterStudy:
    return ParameterStudy(
        name="empty",
        configs=("config/direct.yaml",),
        scenarios=("hold",),
        seeds=trials // 2,
        parameters=_PARAMETERS,  # type: ignore[arg-type]
    )


def local(trials: int) -> Cost:
    with patch.object(engine, "play_alone", empty):
        return _cost("local", study(trials), engine.LOCAL)


def dask(trials: int) -> Cost:
    with _cluster() as cluster, patch.object(engine, "played", empty):
        address = cluster.scheduler_address.replace("tcp://", engine.DASK)
        found = _cost("dask, 2 workers", study(trials), address)
        largest = psutil.Process(cluster.scheduler.process.pid).memory_info().rss / 1e6
    return Cost(**(vars(found) | {"scheduler_mb": largest}))


def _cost(name: str, of: ParameterStudy, where: str) -> Cost:
    with TemporaryDirectory() as folder:
        out = Path(folder)
        began = clock.wall_seconds()
        done = engine.carry_out(of, out, workers=2, engine=where)
        played = clock.wall_seconds()
        write_table(of, done.rows, out)
        written = clock.wall_seconds()
        size = (out / JOURNAL).stat().st_size
    count = len(done.rows)
    here = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return Cost(name, count, played - began, written - played, size / count, here)


@contextmanager
def _cluster() -> Iterator[Any]:
    """A scheduler and two workers, a process each."""
    from distributed import SubprocessCluster  # of an extra

    with SubprocessCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@click.command()
@click.option("--trials", default=100_000, show_default=True, type=click.IntRange(min=2))
def main(trials: int) -> None:
    """Print the table."""
    print(HEAD)
    for each in (local, dask):
        print(each(trials), flush=True)


if __name__ == "__main__":
    sys.exit(main())
