"""Many trials on several processors: resumable, and no trial's failure is the campaign's end.

Trials that begin alike share their bring-up (`tonus.tools.paper.conduct`). Trials are forked from
this process (`tonus.tools.forked_work`), so it must have no thread.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tonus import config as config_room
from tonus import drivers, runtime, sim
from tonus.config.schema.lab import LabScript
from tonus.config.schema.protocol import Protocol
from tonus.config.schema.root import Config
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.timing import clock
from tonus.tools.folders import make_folder
from tonus.tools.forked_work import Tell, crashed, forked
from tonus.tools.paper import metrics
from tonus.tools.paper.case import Run
from tonus.tools.paper.conduct import Together
from tonus.tools.paper.plants import settings_key, settle
from tonus.tools.paper.protocol import robot_seconds
from tonus.tools.paper.results import Results, Row
from tonus.tools.paper.trial import Trial
from tonus.tools.run import parting
from tonus.tools.warm_up import warm

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
    script: LabScript
    """what is there before ACTIVE"""


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
        own = settled[same]
        script = parting.until_active(run.case.scenario.lab, protocol.contact.clear, own)
        jobs.append(Job(run, own, fingerprint(run, own), script))
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
    files.append(Path(parting.__file__))
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
    """Jobs with what became of them, as they are finished; those that begin alike in one process
    and its forks, each with a process of its own from ACTIVE on."""
    first = {job.run.bus: job for job in reversed(jobs)}
    for job in first.values():
        warm(job.config, job.run.case.scenario)

    def carry(together: list[Job], tell: Tell) -> None:
        work(together, folder, lambda row, seconds: tell(_told(row, seconds)))

    heard: set[str] = set()
    for said in forked(_alike(jobs), workers, carry):
        by_key = {job.run.key: job for job in said.job}
        if said.line is not None:
            told, seconds = json.loads(said.line)
            row = Row.from_json(told)
            heard.add(row.key)
            yield by_key[row.key], row, seconds
        else:
            for key in by_key.keys() - heard:
                yield by_key[key], _failed(by_key[key].run, crashed(said.exit_code)), 0.0


def _alike(jobs: list[Job]) -> list[list[Job]]:
    """Jobs that are the same until ACTIVE, in the order of their first ones."""
    found: dict[object, list[Job]] = {}
    for job in jobs:
        same = (settings_key(job.run), job.run.seed, job.script.model_dump_json())
        found.setdefault(same, []).append(job)
    return list(found.values())


def _told(row: Row, seconds: float) -> bytes:
    return json.dumps([row.as_json(), seconds]).encode()


def work(jobs: list[Job], folder: Path, tell: Callable[[Row, float], None]) -> None:
    """Run trials that begin alike, measure them, keep what they came to. ``tell`` is called once
    for each trial, in whichever process it was done, with its row and the s of robot time it took.
    """
    prints = {job.run.key: job.fingerprint for job in jobs}
    config = jobs[0].config
    together = Together(
        [job.run for job in jobs],
        config,
        jobs[0].script,
        lambda run, code: tell(_failed(run, crashed(code)), 0.0),
    )
    done: set[str] = set()
    try:
        for trial in together.play(metrics.NEEDED_CYCLE, metrics.NEEDED_TRUTH):
            row = _measured(trial, folder, prints[trial.run.key])
            done.add(trial.run.key)
            tell(row, trial.ticks * config.control.rates.period)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is these trials'
        for run in together.left:
            if run.key not in done:
                tell(_failed(run, f"{type(error).__name__}: {error}"), 0.0)


def _measured(trial: Trial, folder: Path, fingerprint: str) -> Row:
    run = trial.run
    indicators = metrics.measure(trial)
    if indicators:
        indicators["contact_peak"] = trial.contact_peak
    row = _row(run, indicators, trial.state, trial.reason, trial.fault)
    seconds = trial.ticks * trial.config.control.rates.period
    if run.seed == 1 and run.bus == "direct" and len(trial.time):
        packed = BytesIO()
        np.savez_compressed(packed, **metrics.traces(trial))  # type: ignore[arg-type]
        _put(folder / f"{run.key}.npz", packed.getvalue())
    text = json.dumps({"fingerprint": fingerprint, "row": row.as_json(), "robot_s": seconds})
    # Last, so that where it is everything is.
    _put(folder / f"{run.key}.json", text.encode())
    return row


def _failed(run: Run, reason: str) -> Row:
    return _row(run, {}, "", reason, "")


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
