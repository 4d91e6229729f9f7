"""A study carried out: on this host's processors, a share of it, or by a Dask scheduler."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.runtime.control.controllers.registry import CONTROLLERS
from tonus.runtime.timing import clock
from tonus.tools.campaign.campaign import Standing
from tonus.tools.campaign.journal import Journal
from tonus.tools.campaign.station import cause, watch
from tonus.tools.errors import ToolError
from tonus.tools.forked_work import Tell, forked
from tonus.tools.study.play import COMPLETED, Row, failed
from tonus.tools.study.provenance import firsts, head, loaded
from tonus.tools.study.remote import played
from tonus.tools.study.store import ANEW, JOURNAL
from tonus.tools.study.together import alike, play_alone, play_together
from tonus.tools.study.trials import Trial, in_turn, share, trials
from tonus.tools.warm_up import warm

LOCAL = "local"
RUNS = "runs"
"""folder of what the study keeps of its runs"""
DASK = "dask://"
_CONNECT_S = 10
_WINDOW, _AHEAD = 64, 8
"""trials that the scheduler has at a time: at least, and of each worker thread"""
_ATTEMPTS = 3
"""of a trial whose Dask worker dies"""


@dataclass(frozen=True)
class Share:
    """Number ``number`` (from 1) of ``of`` equal parts of a study."""

    number: int = 1
    of: int = 1


@dataclass
class Studied:
    trials: list[Trial]
    rows: list[Row]
    """by index, as far as they have been played"""
    seconds: float
    kept: int
    interrupted: bool


def carry_out(
    study: ParameterStudy,
    out: Path,
    *,
    workers: int,
    engine: str = LOCAL,
    part: Share = Share(),
    tell: Callable[[Standing], None] = lambda _: None,
) -> Studied:
    """Play every trial of ``part`` that ``out`` has no row of yet. On Ctrl-C what has been recorded
    stays, and the same call goes on from there. Raises `ConfigError` and `ToolError`."""
    wanted = share(trials(study), part.number, part.of)
    with Journal(out, head(study), resume=True, name=JOURNAL, anew=ANEW) as journal:
        numbers = {trial.index for trial in wanted}
        rows = {index: row for index, row in journal.rows.items() if index in numbers}
        todo = [each for each in in_turn(study, wanted) if each.index not in rows]
        kept, began, interrupted = len(rows), clock.wall_seconds(), False
        bad = sum(row["verdict"] != COMPLETED for row in rows.values())
        here = engine == LOCAL
        coming = _local(study, todo, workers, out) if here else _dask(study, todo, engine)
        try:
            for row in coming:
                journal.add(row)
                rows[row["index"]] = row
                bad += row["verdict"] != COMPLETED
                passed = clock.wall_seconds() - began
                tell(Standing(len(rows), len(wanted), kept, bad, passed))
        except KeyboardInterrupt:
            interrupted = True
    passed = clock.wall_seconds() - began
    return Studied(wanted, [rows[each] for each in sorted(rows)], passed, kept, interrupted)


def _local(study: ParameterStudy, todo: Sequence[Trial], workers: int, out: Path) -> Iterator[Row]:
    """Each trial in a process of its own, which its crash ends alone."""

    def work(trials: list[Trial], tell: Tell) -> None:
        def told(row: Row) -> None:
            tell(json.dumps(row, separators=(",", ":")).encode())

        if len(trials) > 1:
            play_together(study, trials, out / RUNS, told)
            return
        watch(study.longest)
        told(play_alone(study, trials[0], out / RUNS / f"{trials[0].index:06d}"))

    if todo:
        _warm(study)
    heard: set[int] = set()
    for said in forked(alike(study, todo), workers, work):
        if said.line is not None:
            row = json.loads(said.line)
            if row["index"] not in heard:
                heard.add(row["index"])
                yield row
            continue
        for trial in said.job:
            if trial.index not in heard:
                yield failed(study, trial, cause(said.exit_code, study.longest))


def _warm(study: ParameterStudy) -> None:
    """For the runs of each configuration. A controller that is not ours may do anything, and does
    it in its run alone."""
    done: set[str] = set()
    for trial in firsts(study):
        config, scenario = loaded(study, trial)
        if trial.config in done or config.control.controller not in CONTROLLERS:
            continue
        done.add(trial.config)
        warm(config, scenario)


def _dask(study: ParameterStudy, todo: Sequence[Trial], engine: str) -> Iterator[Row]:
    """By the workers of a running scheduler; each needs this version of Tonus. Raises `ToolError`
    where there is none."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise ToolError(f"--engine {engine}: needs Dask: pip install 'tonus[study]'") from error
    if study.keep != "figures":
        raise ToolError(f"--engine {engine}: keeps no logs; set keep: figures, or play it here")
    # What it would log is told below in a line; its own way is tracebacks.
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    address = engine.replace(DASK, "tcp://", 1)
    try:
        client = distributed.Client(address, timeout=_CONNECT_S)
    except (OSError, TimeoutError) as error:
        raise ToolError(f"--engine {engine}: no scheduler answers there: {error}") from error
    with client:
        _need_alike(engine, client.run(head, study), head(study))
        of: dict[str, Trial] = {}
        waiting = iter(todo)

        def given(count: int) -> list[Any]:
            """The next so many, given to the scheduler."""
            found = []
            for trial in islice(waiting, count):
                future = client.submit(played, study, trial, retries=_ATTEMPTS, pure=False)
                of[future.key] = trial
                found.append(future)
            return found

        # A scheduler that holds all trials of a large study takes gigabytes and forgets none.
        threads = sum(client.nthreads().values())
        running = distributed.as_completed(given(max(_WINDOW, _AHEAD * threads)))
        for future in running:
            running.update(given(1))
            if future.status == "finished":
                yield future.result()
            elif future.status != "error":  # lost or cancelled: not the run's fault, so no row
                gone = "the scheduler is gone; start it again, and the same command goes on"
                raise ToolError(f"--engine {engine}: {gone}")
            else:
                yield failed(study, of[future.key], f"lost by its worker: {future.exception()}")
            del of[future.key]


def _need_alike(engine: str, workers: dict[str, dict[str, Any]], ours: dict[str, Any]) -> None:
    """Raises `ToolError` where a worker would play something else."""
    for address, theirs in workers.items():
        other = ", ".join(key for key in ours if theirs[key] != ours[key])
        if other:
            problem = f"--engine {engine}: the worker at {address} has another {other}"
            raise ToolError(f"{problem}; install the same there, with the same files")
