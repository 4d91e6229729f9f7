"""Many trials on several processors: resumable, and no trial's failure is the campaign's end."""

from __future__ import annotations

import json
import multiprocessing
import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tonus import config as config_room
from tonus import drivers, runtime, sim
from tonus.config.schema.protocol import Protocol
from tonus.config.schema.root import Config
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.timing import clock
from tonus.tools.folders import make_folder
from tonus.tools.paper import metrics
from tonus.tools.paper.case import Run
from tonus.tools.paper.conduct import conduct
from tonus.tools.paper.plants import settings_key, settle
from tonus.tools.paper.protocol import robot_seconds
from tonus.tools.paper.results import Results, Row

Json = dict[str, Any]
TRIALS = "trials"
_ROOMS = (config_room, drivers, runtime, sim)
_OWN = ("case", "conduct", "forces", "indicators", "metrics", "trial")
"""Modules of this package that decide what a trial comes to."""


@dataclass(frozen=True)
class Job:
    """A trial with its configuration and the fingerprint of everything it depends on."""

    run: Run
    config: Config
    fingerprint: str


@dataclass(frozen=True)
class Progress:
    """How far a campaign has come."""

    done: int
    total: int
    kept: int
    """of these, from an earlier campaign"""
    robot_seconds: float
    """of the trials that were run now"""
    wall_seconds: float
    share: float
    """of the robot time, 0 to 1"""
    fresh: float
    """the part of it that was run now"""
    latest: str
    """the trial that came in last"""

    @property
    def factor(self) -> float:
        """Robot time over wall time, all processes together."""
        return self.robot_seconds / self.wall_seconds if self.wall_seconds > 0.0 else 0.0

    @property
    def left(self) -> float:
        """s of wall time, at the pace so far."""
        return self.wall_seconds * (1.0 - self.share) / self.fresh if self.fresh > 0.0 else 0.0


@dataclass
class Campaign:
    """What a campaign has come to."""

    results: Results
    failed: list[Row]
    """trials that could not be run; their reason is an exception's text"""
    robot_seconds: float
    wall_seconds: float
    kept: int
    interrupted: bool = False


def prepare(protocol: Protocol, config: Config, runs: list[Run]) -> list[Job]:
    """Configurations and fingerprints. Raises `ToolError`."""
    settled: dict[object, Config] = {}
    jobs = []
    for run in runs:
        same = settings_key(run)
        if same not in settled:
            settled[same] = settle(protocol, config, run)
        jobs.append(Job(run, settled[same], fingerprint(run, settled[same])))
    return jobs


def fingerprint(run: Run, config: Config) -> str:
    """Of all that decides a trial's outcome: configuration, scenario, seed, signals and code."""
    digest = sha256()
    for part in (
        run.key,
        run.case.kind,
        str(run.seed),
        str(SCHEMA_VERSION),
        config.model_dump_json(),
        run.case.scenario.model_dump_json(),
        _code(),
    ):
        digest.update(part.encode() + b"\0")
    return digest.hexdigest()[:32]


@cache
def _code() -> str:
    """A digest of the sources that a trial runs through."""
    digest = sha256()
    files: list[Path] = []
    for room in _ROOMS:
        for folder in room.__path__:
            files += sorted(Path(folder).rglob("*.py"))
    files += [Path(__file__).with_name(f"{name}.py") for name in _OWN]
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def carry_out(
    jobs: list[Job], out: Path, workers: int, tell: Callable[[Progress], None]
) -> Campaign:
    """Run what has not been run, and gather the rows in the order of ``jobs``.

    On Ctrl-C what has been finished stays, and the same call goes on from there.
    """
    folder = out / TRIALS
    make_folder(folder)
    kept = {job.run.key: row for job in jobs if (row := _finished(folder, job)) is not None}
    todo = sorted(
        (job for job in jobs if job.run.key not in kept),
        key=lambda job: -_length(job),
    )
    rows = dict(kept)
    expected = sum(_length(job) for job in jobs)
    before = covered = sum(_length(job) for job in jobs if job.run.key in kept)
    began, passed, robot = clock.wall_seconds(), 0.0, 0.0
    failed: list[Row] = []
    interrupted = False
    try:
        for job, row, seconds in _answers(todo, folder, workers):
            rows[job.run.key] = row
            if not row.state:
                failed.append(row)
            robot += seconds
            covered += _length(job)
            passed = clock.wall_seconds() - began
            tell(
                Progress(
                    done=len(rows),
                    total=len(jobs),
                    kept=len(kept),
                    robot_seconds=robot,
                    wall_seconds=passed,
                    share=covered / expected,
                    fresh=(covered - before) / expected,
                    latest=job.run.key,
                )
            )
    except KeyboardInterrupt:
        interrupted = True
    results = Results(
        [rows[job.run.key] for job in jobs if job.run.key in rows],
        lambda key: _traces(folder / f"{key}.npz"),
    )
    return Campaign(results, failed, robot, passed, len(kept), interrupted)


def _length(job: Job) -> float:
    """s of robot time, about."""
    return robot_seconds(job.config, job.run)


def _answers(jobs: list[Job], folder: Path, workers: int) -> Iterator[tuple[Job, Row, float]]:
    """Jobs with what became of them, as they are finished. A worker that dies takes its pool with
    it; what was then under way is tried once more, one by one, so that the culprit is found."""
    suspects: list[Job] = []
    waiting = list(reversed(jobs))
    while waiting or suspects:
        alone = not waiting
        batch, size = ([suspects.pop()], 1) if alone else (waiting, workers)
        pool = _pool(size)
        try:
            under_way: dict[Future[tuple[Row, float]], Job] = {}
            while batch or under_way:
                while batch and len(under_way) < size:
                    job = batch.pop()
                    under_way[pool.submit(work, job, folder)] = job
                done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                broken = [future for future in done if _broke(future)]
                for future in done:
                    if future not in broken:
                        yield (job := under_way.pop(future)), *_answer(job, future)
                if broken:
                    if alone:
                        job = under_way.pop(broken[0])
                        yield job, *_answer(job, broken[0])
                    else:
                        suspects += under_way.values()
                    break
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _broke(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _answer(job: Job, future: Future[tuple[Row, float]]) -> tuple[Row, float]:
    error = future.exception()
    if error is None:
        return future.result()
    return _row(job.run, {}, "", f"{type(error).__name__}: {error}", ""), 0.0


def _pool(workers: int) -> ProcessPoolExecutor:
    """Processes that import once and start from there, each for many trials."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tonus.tools.paper.campaign"])
    # Matrices of eight rows are no work for a second thread.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return ProcessPoolExecutor(
        workers, mp_context=context, initializer=_go_with, initargs=(os.getpid(),)
    )


def _go_with(campaign: int) -> None:
    """In a worker: Ctrl-C, or the end of the campaign's process however it comes, ends it at once.
    What it has not finished is nowhere yet."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # The worker's own parent is the fork server, which outlives the campaign as long as it lives.
    threading.Thread(target=_end_with, args=(os.pidfd_open(campaign),), daemon=True).start()


def _end_with(process: int) -> None:
    select.select([process], [], [])
    os._exit(1)


def work(job: Job, folder: Path) -> tuple[Row, float]:
    """In a worker: run a trial, measure it, keep what it came to. Returns its row and the s of
    robot time it took."""
    run = job.run
    traced = run.seed == 1 and run.bus == "direct"
    trial = conduct(run, job.config, cycle=metrics.NEEDED_CYCLE, truth=metrics.NEEDED_TRUTH)
    indicators = metrics.measure(trial)
    if indicators:
        indicators["contact_peak"] = trial.contact_peak
    row = _row(run, indicators, trial.state, trial.reason, trial.fault)
    seconds = trial.ticks * job.config.control.rates.period
    if traced and len(trial.time):
        packed = BytesIO()
        np.savez_compressed(packed, **metrics.traces(trial))  # type: ignore[arg-type]
        _put(folder / f"{run.key}.npz", packed.getvalue())
    text = json.dumps({"fingerprint": job.fingerprint, "row": row.as_json(), "robot_s": seconds})
    # Last, so that where it is everything is.
    _put(folder / f"{run.key}.json", text.encode())
    return row, seconds


def _row(run: Run, indicators: dict[str, float], state: str, reason: str, fault: str) -> Row:
    return Row(
        key=run.key,
        stage=run.case.stage,
        case=run.case.name,
        kind=str(run.case.kind),
        controller=run.controller,
        plant=run.plant,
        seed=run.seed,
        bus=run.bus,
        indicators=indicators,
        state=state,
        reason=reason,
        fault=fault,
    )


def _finished(folder: Path, job: Job) -> Row | None:
    """The row of a trial that an earlier campaign has run, if it still stands."""
    try:
        kept = json.loads((folder / f"{job.run.key}.json").read_text(encoding="utf-8"))
        if kept["fingerprint"] != job.fingerprint:
            return None
        return Row.from_json(kept["row"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _traces(path: Path) -> dict[str, Any] | None:
    try:
        with np.load(path) as packed:
            return {name: packed[name] for name in packed.files}
    except FileNotFoundError:
        return None


def _put(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_bytes(data)
    beside.replace(path)
