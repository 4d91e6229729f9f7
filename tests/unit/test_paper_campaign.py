"""A campaign in real processes: it goes on after an interruption, and after a trial that raises or
crashes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from loop import QUICK

from tonus.config import load
from tonus.config.loader import load_protocol
from tonus.config.schema.scenario import Scenario
from tonus.tools.cli.paper import paper
from tonus.tools.errors import ToolError
from tonus.tools.paper import metrics
from tonus.tools.paper.campaign import TRIALS, Job, Progress, carry_out, fingerprint, prepare
from tonus.tools.paper.case import Run
from tonus.tools.paper.protocol import Programme
from tonus.tools.paper.trial import Trial

PROTOCOL = load_protocol()
BRISK, _ = load("config/direct.yaml", overrides=QUICK)


def jobs(*controllers: str, duration: float = 0.3) -> list[Job]:
    case = next(case for case in Programme(PROTOCOL, BRISK).cases() if case.name == "hold")
    case = replace(case, scenario=case.scenario.model_copy(update={"duration": duration}))
    todo = [Run(case, controller, "lab", 1, "direct") for controller in controllers]
    return prepare(PROTOCOL, BRISK, todo)


MEASURE = metrics.measure


def deadly(trial: Trial) -> dict[str, float]:
    """`measure`, but a trial of pd, and any sine, ends its process."""
    if trial.run.controller == "pd" or trial.run.case.name.startswith("sine"):
        os._exit(1)
    return MEASURE(trial)


def begin_alike(duration: float = 0.3) -> list[Job]:
    """Four tests of one robot with one controller, and the first of them with another."""
    cases = {case.name: case for case in Programme(PROTOCOL, BRISK).cases()}
    runs = []
    for name in ("hold", "sine_z_30mm_1Hz", "step_x", "press"):
        lasting = 3 * duration if name == "press" else duration  # it touches after a second
        scenario = cases[name].scenario.model_copy(update={"duration": lasting})
        case = replace(cases[name], scenario=scenario)
        runs.append(Run(case, "bio", "lab", 1, "direct"))
    return prepare(PROTOCOL, BRISK, [*runs, replace(runs[0], controller="pd")])


@pytest.mark.long
def test_it_goes_on_where_it_was_interrupted_and_gives_the_same(tmp_path: Path) -> None:
    todo = jobs("bio", "pd")

    def interrupt(standing: Progress) -> None:
        assert standing.done == 1
        raise KeyboardInterrupt

    first = carry_out(todo, tmp_path, 1, interrupt)
    assert first.interrupted
    assert len(first.results.rows) == 1

    # What a kill leaves behind: a file in the making, one cut short, and one of another time.
    folder = tmp_path / TRIALS
    whole = next(folder.glob("*.json"))
    (folder / f".{whole.name}.4711").write_bytes(b"{")
    told: list[Progress] = []
    second = carry_out(todo, tmp_path, 1, told.append)
    assert (second.kept, len(told), second.interrupted) == (1, 1, False)
    assert [row.controller for row in second.results.rows] == ["bio", "pd"]
    assert all(row.completed for row in second.results.rows)
    assert second.results.traces(todo[1].run.key) is not None

    kept = json.loads(whole.read_text())
    whole.write_text(json.dumps(kept | {"fingerprint": "old"})[:-1])
    third = carry_out(todo, tmp_path, 1, told.append)
    assert third.kept == 1
    assert json.loads(whole.read_text())["row"] == kept["row"]


@pytest.mark.wide
def test_neither_an_exception_nor_a_dead_process_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "measure", deadly)
    good, dead, broken = jobs("bio", "pd", "pid")
    broken = replace(broken, config=broken.config.model_copy(update={"lab": None}))
    campaign = carry_out([good, dead, broken], tmp_path, 2, lambda _: None)
    rows = {row.controller: row for row in campaign.results.rows}
    assert rows["bio"].completed
    assert rows["pd"].reason == "crashed: exit code 1"
    assert "lab section" in rows["pid"].reason
    assert {row.controller for row in campaign.failed} == {"pd", "pid"}
    assert not rows["pd"].completed


@pytest.mark.wide
def test_trials_that_begin_alike_are_what_each_is_by_itself(tmp_path: Path) -> None:
    # Long enough for the load, which comes half a second after ACTIVE.
    todo = begin_alike(duration=0.8)
    together = carry_out(todo, tmp_path / "together", 1, lambda _: None)
    rows = {row.key: row for row in together.results.rows}
    for job in todo:
        alone = carry_out([job], tmp_path / "alone", 1, lambda _: None)
        assert alone.results.rows == [rows[job.run.key]]
        assert rows[job.run.key].completed
        for suffix in ("json", "npz"):
            name = Path(TRIALS, f"{job.run.key}.{suffix}")
            assert (tmp_path / "together" / name).read_bytes() == (
                tmp_path / "alone" / name
            ).read_bytes()
    peaks = {row.case: row.indicators["contact_peak"] for row in rows.values()}
    assert peaks["hold"] == peaks["step_x"] == 0.0 < peaks["press"]
    assert len({json.dumps(row.indicators) for row in rows.values()}) == len(todo)


def test_only_what_begins_with_active_shares_a_bring_up(monkeypatch: pytest.MonkeyPatch) -> None:
    hold, sine, step, press, pd = begin_alike()
    early = step.run.case.scenario.model_dump()
    early["lab"]["load"]["profile"][0]["at"] = 0.0
    load = Scenario.model_validate(early)
    early_step = replace(step.run, case=replace(step.run.case, scenario=load))
    near = press.run.case.scenario.model_dump()
    near["lab"]["phantom"]["point"] = (0.001, *near["lab"]["phantom"]["point"][1:])
    body = Scenario.model_validate(near)
    near_press = replace(press.run, case=replace(press.run.case, scenario=body))
    others = [early_step, near_press, replace(sine.run, seed=2)]
    unlike = prepare(PROTOCOL, BRISK, others)
    todo = [hold, sine, step, press, pd, *unlike]
    kept: list[list[Job]] = []

    def noted(jobs: list[list[Job]], *_: Any) -> list[Any]:
        kept.extend(jobs)
        return []

    monkeypatch.setattr("tonus.tools.paper.campaign.forked", noted)
    carry_out(todo, Path("unused"), 1, lambda _: None)
    groups = {frozenset(map(id, jobs)) for jobs in kept}
    alone = {frozenset([id(job)]) for job in (pd, *unlike)}
    assert groups == {frozenset(map(id, (hold, sine, step, press))), *alone}


def test_of_trials_that_begin_alike_a_dead_one_is_the_only_one_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "measure", deadly)
    hold, sine, step, *_ = begin_alike()
    campaign = carry_out([hold, sine, step], tmp_path, 1, lambda _: None)
    assert [row.completed for row in campaign.results.rows] == [True, False, True]
    assert [row.reason for row in campaign.failed] == ["crashed: exit code 1"]
    assert not (tmp_path / TRIALS / f"{sine.run.key}.json").exists()


def test_a_bring_up_that_fails_is_the_end_of_each_trial_that_shares_it(tmp_path: Path) -> None:
    hold, sine, *_ = begin_alike()
    cut = {"kind": "cable_cut", "axis": 1, "at": 0.05}

    def torn(job: Job) -> Job:
        case = job.run.case
        plain = case.scenario.model_dump() | {"lab": {"faults": [cut]}}
        case = replace(case, scenario=Scenario.model_validate(plain))
        return replace(job, run=replace(job.run, case=case), script=case.scenario.lab)

    campaign = carry_out([torn(hold), torn(sine)], tmp_path, 1, lambda _: None)
    assert not campaign.failed
    assert [row.state for row in campaign.results.rows] == ["FAULT", "FAULT"]
    assert len({row.reason for row in campaign.results.rows}) == 1


CHILD = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from test_paper_campaign import jobs
from tonus.tools.paper.campaign import carry_out
if __name__ == "__main__":
    carry_out(jobs("bio") + jobs("pd", duration=1000.0), Path(sys.argv[1]), 2, lambda _: None)
"""


@pytest.mark.long
@pytest.mark.realtime
def test_a_kill_leaves_what_is_done_and_no_worker(tmp_path: Path) -> None:
    script = tmp_path / "campaign.py"
    script.write_text(CHILD)
    here = Path(__file__).parent
    mark = f"TONUS_TEST_MARK={tmp_path}"
    child = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path), str(here), str(here.parent)],
        env=os.environ | dict([mark.split("=", 1)]),
    )
    done = tmp_path / TRIALS / f"{jobs('bio')[0].run.key}.json"
    try:
        waited(done.exists, 300)
        assert len(marked(mark)) >= 2
    finally:
        child.kill()
        child.wait()
    waited(lambda: not marked(mark), 60)
    assert carry_out(jobs("bio"), tmp_path, 1, lambda _: None).kept == 1


def waited(met: Callable[[], bool], seconds: int) -> None:
    ticking = threading.Event()
    for _ in range(10 * seconds):
        if met():
            return
        ticking.wait(0.1)
    raise AssertionError("it did not come to that")


def marked(mark: str) -> list[str]:
    """Processes that were started with this in their environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if mark.encode() in (process / "environ").read_bytes().split(b"\0"):
                found.append(process.name)
    return found


def test_a_fingerprint_knows_what_a_trial_depends_on() -> None:
    (job,) = jobs("bio")
    other = job.config.model_copy(update={"name": "other"})
    longer = jobs("bio", duration=0.4)[0].run
    prints = {
        fingerprint(job.run, job.config),
        fingerprint(job.run, other),
        fingerprint(longer, job.config),
        fingerprint(replace(job.run, seed=2), job.config),
    }
    assert len(prints) == 4
    assert jobs("bio")[0].fingerprint == job.fingerprint


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--controllers", "bio,nobody"], "nobody"),
        (["--controllers", "eq9_literal"], "test of its own"),
        (["--stages", "4"], "--stages"),
        (["config/can.yaml"], "direct"),
    ],
)
def test_what_is_asked_wrongly_is_said_before_anything_runs(
    options: list[str], said: str, tmp_path: Path
) -> None:
    answer = CliRunner().invoke(paper, [*options, "--out", str(tmp_path / "out")])
    assert isinstance(answer.exception, ToolError)
    assert said in str(answer.exception)
    assert not (tmp_path / "out").exists()
