"""Studies carried out alone, in shares and by Dask; interrupted, crashed, and repeated."""

from __future__ import annotations

import json
import os
import shlex
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from loop import QUICK

from tonus.config.loader import load_parameter_study
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.cli.main import tonus
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.study import engine
from tonus.tools.study.engine import Share, carry_out
from tonus.tools.study.play import Row, _digest
from tonus.tools.study.remote import played
from tonus.tools.study.store import write_table
from tonus.tools.study.trials import Trial, trials

pytestmark = pytest.mark.wide

SMALL: dict[str, Any] = {
    "name": "small",
    "configs": ["config/direct.yaml"],
    "scenarios": ["hold"],
    "seeds": 1,
    "duration": 0.2,
    "overrides": QUICK,
    "parameters": {"control.stiffness.base": [3000.0, 3100.0, 3210.0]},
    "measures": {"k": {"topic": "stiffness", "field": "k_eq", "take": "mean"}},
    "shown": ["tracking_rms_mm", "k"],
}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "small.yaml"
    path.write_text(json.dumps(SMALL))
    return path


@pytest.fixture(scope="module")
def whole(file: Path) -> Path:
    """The folder of the study, carried out on two processors."""
    out = file.parent / "whole"
    done = CliRunner().invoke(tonus, ["campaign", str(file), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "3 runs, 0 not completed" in done.output
    return out


def rows_of(folder: Path) -> list[Row]:
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()[1:]]


def test_each_row_has_its_figures_and_the_parameter_acts(whole: Path) -> None:
    rows = sorted(rows_of(whole), key=lambda row: row["index"])
    assert [row["verdict"] for row in rows] == ["completed"] * 3
    assert rows[0]["k"] == pytest.approx(3000.0, rel=0.02)
    assert rows[2]["k"] == pytest.approx(3210.0, rel=0.02)
    assert all(0.0 < row["tracking_rms_mm"] < 0.5 for row in rows)
    assert len({row["digest"] for row in rows}) == 3
    assert not list((whole / "runs").rglob("*.mcap")), "no log is kept"


def test_a_row_is_repeated_by_its_command(whole: Path, tmp_path: Path) -> None:
    row = rows_of(whole)[0]
    words = shlex.split(row["command"])[1:]
    done = CliRunner().invoke(tonus, [*words, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert _digest(open_log(tmp_path / "run.mcap")) == row["digest"]


def test_shares_together_are_the_same_bytes(file: Path, whole: Path, tmp_path: Path) -> None:
    shares = [tmp_path / "1", tmp_path / "2"]
    for number, folder in enumerate(shares, start=1):
        words = ["campaign", str(file), "--shard", f"{number}/2", "--out", str(folder)]
        assert CliRunner().invoke(tonus, [*words, "--workers", "1"]).exit_code == 0
    words = ["campaign", "merge", *map(str, shares), "--out", str(tmp_path / "all")]
    assert CliRunner().invoke(tonus, words).exit_code == 0
    for name in ("trials.parquet", "index.html"):
        assert (tmp_path / "all" / name).read_bytes() == (whole / name).read_bytes()


def test_the_same_command_plays_nothing_twice(
    file: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> Row:
        raise AssertionError("played again")

    monkeypatch.setattr(engine, "play_alone", never)
    before = (whole / "trials.parquet").read_bytes()
    done = CliRunner().invoke(tonus, ["campaign", str(file), "--out", str(whole)])
    assert done.exit_code == 0, done.output
    assert (whole / "trials.parquet").read_bytes() == before


def test_an_interrupted_study_goes_on_where_it_was_left(
    file: Path, whole: Path, tmp_path: Path
) -> None:
    study = load_parameter_study(file)

    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    first = carry_out(study, tmp_path, workers=1, tell=interrupt)
    assert first.interrupted
    assert len(first.rows) == 1
    second = carry_out(study, tmp_path, workers=2)
    assert (second.kept, len(second.rows)) == (1, 3)
    written = write_table(study, second.rows, tmp_path)
    assert written.read_bytes() == (whole / "trials.parquet").read_bytes()


def test_what_goes_wrong_in_a_run_is_its_row(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault, a configuration that is refused, a crash: the others go on."""
    study = load_parameter_study(file).model_copy(
        update={
            "seeds": 1,
            "parameters": {"control.stiffness.base": (3000.0, -1.0, 3100.0, 3210.0)},
            "keep": "failures",
        }
    )
    torn = tmp_path / "torn.yaml"
    cut = {"kind": "cable_cut", "axis": 2, "at": 2.5}
    told = {"name": "torn", "description": "a cable tears", "duration": 2.0}
    lab = {"reference": {"kind": "hold"}, "lab": {"faults": [cut]}}
    torn.write_text(json.dumps(told | lab))
    usual = engine.play_alone

    def crash(study: ParameterStudy, trial: Trial, folder: Path) -> Row:
        if trial.index == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        if trial.index == 3:
            trial = replace(trial, scenario=str(torn))
        return usual(study, trial, folder)

    monkeypatch.setattr(engine, "play_alone", crash)
    rows = carry_out(study, tmp_path, workers=2, part=Share()).rows
    assert rows[0]["verdict"] == "completed"
    assert rows[1]["verdict"] == "error"
    assert "control.stiffness.base" in rows[1]["reason"]
    assert (rows[2]["verdict"], rows[2]["reason"]) == ("error", "crashed: SIGKILL")
    assert rows[3]["verdict"] == "cable_torn"
    kept = {path.parent.name for path in (tmp_path / "runs").rglob("run.mcap")}
    assert kept == {"000003"}


def test_by_dask_it_is_the_same_table_though_a_worker_dies(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two trials at a time: the scheduler gets the others when these are done."""
    monkeypatch.setattr("tonus.tools.study.engine._WINDOW", 1)
    monkeypatch.setattr("tonus.tools.study.engine._AHEAD", 1)
    distributed = pytest.importorskip("distributed", reason="pip install 'tonus[study]'")
    study = load_parameter_study(file)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(processes=True, **options) as cluster:
        victims = [worker.pid for worker in cluster.workers.values()]

        def kill(_: object) -> None:
            if victims:
                os.kill(victims.pop(), signal.SIGKILL)
                victims.clear()

        address = cluster.scheduler_address.replace("tcp://", "dask://")
        found = carry_out(study, tmp_path, workers=2, engine=address, tell=kill)
    assert [row["index"] for row in found.rows] == [0, 1, 2]
    table = write_table(study, found.rows, tmp_path)
    assert table.read_bytes() == (whole / "trials.parquet").read_bytes()


@pytest.mark.long
def test_what_a_lost_scheduler_had_is_played_by_the_next_call(
    file: Path, whole: Path, tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="pip install 'tonus[study]'")
    study = load_parameter_study(file)
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(processes=True, **options) as cluster:
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        with pytest.raises(ToolError, match="the same command goes on"):
            carry_out(study, tmp_path, workers=1, engine=address, tell=lambda _: cluster.close())
    assert [row["verdict"] for row in rows_of(tmp_path)] == ["completed"]
    found = carry_out(study, tmp_path, workers=2)
    assert (found.kept, len(found.rows)) == (1, 3)
    table = write_table(study, found.rows, tmp_path)
    assert table.read_bytes() == (whole / "trials.parquet").read_bytes()


def test_a_run_without_end_is_given_up_by_a_worker_too(file: Path) -> None:
    study = load_parameter_study(file).model_copy(update={"longest": 1, "duration": 1000.0})
    trial, *_ = trials(study)
    row = played(study, trial)
    assert (row["verdict"], row["reason"]) == ("error", "hung: no end in 1 s of processor time")


def test_a_worker_that_reads_another_configuration_is_refused(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="pip install 'tonus[study]'")
    study = load_parameter_study(file)
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(processes=True, **options) as cluster:
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        usual = engine.head
        monkeypatch.setattr(engine, "head", lambda of: usual(of) | {"code": os.getpid()})
        with pytest.raises(ToolError, match="has another code"):
            carry_out(study, tmp_path, workers=1, engine=address)


def test_without_a_scheduler_it_is_one_line(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_CONNECT_S", 0.5)
    words = ["campaign", str(file), "--engine", "dask://127.0.0.1:9", "--out", str(tmp_path)]
    done = CliRunner().invoke(tonus, words)
    assert "no scheduler answers there" in str(done.exception)
    words[3] = "slurm"
    assert "choose local or dask://" in str(CliRunner().invoke(tonus, words).exception)
