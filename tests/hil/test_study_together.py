"""Runs of a study that share a bring-up have the rows that they have alone, and one that goes wrong
is its own row."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from loop import QUICK

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.study import together
from tonus.tools.study.engine import carry_out
from tonus.tools.study.play import COMPLETED, SECONDS, Row, play
from tonus.tools.study.provenance import loaded
from tonus.tools.study.together import _beginning, _Settled, alike
from tonus.tools.study.trials import Trial, trials

pytestmark = pytest.mark.wide

PAPER = ["paper_press", "paper_move", "paper_sine", "paper_ramp", "paper_step"]


def study(**changes: Any) -> ParameterStudy:
    values: dict[str, Any] = {
        "name": "together",
        "configs": ["config/direct.yaml"],
        "scenarios": ["hold", *PAPER],
        "controllers": ["pid", "bio"],
        "seeds": 1,
        "duration": 1.0,
        "overrides": QUICK,
        "measures": {"k": {"topic": "stiffness", "field": "k_eq", "take": "mean"}},
        "indicators": ["overshoot_percent", "contact_force_rmse"],
        "shown": ["tracking_rms_mm", "k"],
    }
    return ParameterStudy.model_validate(values | changes)


def beginnings(planned: ParameterStudy) -> list[int]:
    """How many bring-ups each set of trials has."""
    return [
        len({_beginning(_Settled(each, *loaded(planned, each))) for each in part})
        for part in alike(planned, trials(planned))
    ]


def by_index(rows: list[Row]) -> dict[int, Row]:
    return {row["index"]: {key: row[key] for key in row if key != SECONDS} for row in rows}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        # What a lean record leaves out.
        {
            "scenarios": ["hold", "paper_sine"],
            "measures": {"r": {"topic": "pose", "field": "residual", "take": "max"}},
        },
        # With a supervisor, which reads the records.
        {
            "configs": ["config/can.yaml"],
            "scenarios": ["hold", "paper_sine"],
            "controllers": ["bio"],
            "duration": 0.3,
        },
        {
            "configs": ["config/ethercat.yaml"],
            "scenarios": ["hold", "paper_sine"],
            "controllers": ["bio"],
            "duration": 0.3,
        },
    ],
    ids=["the paper's", "residuals", "CAN", "EtherCAT"],
)
def test_a_run_that_shares_its_bring_up_is_the_same(
    changes: dict[str, Any], tmp_path: Path
) -> None:
    planned = study(**changes)
    assert set(beginnings(planned)) == {1}
    rows = by_index(carry_out(planned, tmp_path, workers=2).rows)
    alone = by_index([play(planned, each, tmp_path / "alone") for each in trials(planned)])
    assert {row["verdict"] for row in rows.values()} == {COMPLETED}
    assert rows == alone
    assert len({row["digest"] for row in rows.values()}) > 1, "they part"
    assert not list((tmp_path / "runs").rglob("*")), "nothing is written of them"


def test_a_load_is_watched_from_the_bring_up_on() -> None:
    """On a bus it ends at another time for that."""
    both = {"scenarios": ["hold", "paper_ramp"], "controllers": ["bio"]}
    assert beginnings(study(**both)) == [1]
    assert beginnings(study(**both, configs=["config/can.yaml"])) == [2]


def test_what_differs_before_active_begins_by_itself(tmp_path: Path) -> None:
    """A load from the first second on, and an operator who stops the bring-up."""
    early = {
        "load": {
            "point": [0, 0, 0],
            "direction": [1, 0, 0],
            "profile": [{"at": 0.0, "force": 0.0}, {"at": 0.5, "force": 1.0}],
        }
    }
    told = "name: {}\ndescription: of a test\nduration: 0.2\nreference: {{kind: hold}}\n"
    for name, more in (
        ("plain", {}),
        ("pulled", {"lab": early}),
        ("stopped", {"operator": [{"at": 0.5, "command": "stop"}]}),
    ):
        (tmp_path / f"{name}.yaml").write_text(told.format(name) + f"{more}"[1:-1] + "\n")
    files = [str(tmp_path / f"{name}.yaml") for name in ("plain", "pulled", "stopped")]
    planned = study(scenarios=["hold", *files], controllers=["bio"], duration=None)
    assert beginnings(planned) == [3]
    rows = by_index(carry_out(planned, tmp_path / "out", workers=1).rows)
    alone = by_index([play(planned, each, tmp_path / "alone") for each in trials(planned)])
    assert rows == alone


def test_logs_that_are_kept_are_of_whole_runs() -> None:
    planned = study(keep="all")
    assert alike(planned, trials(planned)) == [[each] for each in trials(planned)]
    frames = {"f": {"topic": "/tonus/bus/can0", "field": "id", "take": "max"}}
    planned = study(measures=frames)
    assert alike(planned, trials(planned)) == [[each] for each in trials(planned)]


def test_one_that_goes_wrong_is_its_own_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = together.row_of

    def row_of(planned: ParameterStudy, trial: Trial, *rest: Any) -> Row:
        if trial.scenario == "paper_move":
            raise ValueError("of the third kind")
        if trial.scenario == "paper_ramp":
            os.kill(os.getpid(), signal.SIGKILL)
        return usual(planned, trial, *rest)

    monkeypatch.setattr(together, "row_of", row_of)
    planned = study(controllers=["bio"])
    rows = {row["scenario"]: row for row in carry_out(planned, tmp_path, workers=1).rows}
    assert len(rows) == 6
    assert "of the third kind" in rows.pop("paper_move")["reason"]
    assert "SIGKILL" in rows.pop("paper_ramp")["reason"]
    assert {row["verdict"] for row in rows.values()} == {COMPLETED}


def test_a_bring_up_that_dies_is_a_row_of_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(together.Lab, "open", lambda _: os.kill(os.getpid(), signal.SIGKILL))
    planned = study(controllers=["bio"], scenarios=["hold", "paper_sine"])
    rows = carry_out(planned, tmp_path, workers=1).rows
    assert [row["reason"] for row in rows] == ["crashed: SIGKILL"] * 2

    def refused(_: object) -> None:
        raise OSError("no lab today")

    monkeypatch.setattr(together.Lab, "open", refused)
    rows = carry_out(planned, tmp_path / "again", workers=1).rows
    assert [row["reason"] for row in rows] == ["no lab today"] * 2
    assert {row["verdict"] for row in rows} == {"error"}
