"""A study's file, its runs and their order, and what its rows become."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
from click.testing import CliRunner

from tests.bench import study_scale
from tonus.config.errors import ConfigError
from tonus.config.loader import HERE, load_parameter_study
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.campaign.journal import Journal
from tonus.tools.cli.main import tonus
from tonus.tools.errors import ToolError
from tonus.tools.study.groups import differences, groups
from tonus.tools.study.page import write_page
from tonus.tools.study.play import COMPLETED, FIGURES, Row, failed, play
from tonus.tools.study.provenance import head
from tonus.tools.study.store import ANEW, JOURNAL, merged, write_table
from tonus.tools.study.trials import Trial, share, trials

MINIMAL: dict[str, Any] = {"name": "x", "configs": ["config/direct.yaml"], "scenarios": ["hold"]}
BASE, PRE = "control.stiffness.base", "control.tension.pre"


def study(**changes: Any) -> ParameterStudy:
    return ParameterStudy.model_validate(MINIMAL | changes)


def row(of: ParameterStudy, trial: Trial, value: float | None = 1.0) -> Row:
    made = failed(of, trial, "none") | {"verdict": COMPLETED, "reason": "done"}
    return made | dict.fromkeys(FIGURES, value)


def test_every_combination_is_a_run_with_the_same_seeds() -> None:
    of = study(
        controllers=["bio", "pid"],
        seeds=[3, 5],
        parameters={BASE: [3000.0, 3200.0], PRE: {"low": 40.0, "high": 50.0, "steps": 3}},
    )
    found = trials(of)
    assert [each.index for each in found] == list(range(2 * 2 * 3 * 2))
    assert [each.seed for each in found[:4]] == [3, 5, 3, 5]
    assert [each.parameters[PRE] for each in found[:6:2]] == [40.0, 45.0, 50.0]
    assert {each.controller for each in found[:12]} == {"bio"}
    assert len({json.dumps([each.controller, each.seed, each.parameters]) for each in found}) == 24


def test_steps_by_their_logarithm() -> None:
    of = study(parameters={BASE: {"low": 10.0, "high": 1000.0, "steps": 3, "log": True}})
    assert [each.parameters[BASE] for each in trials(of)] == pytest.approx([10.0, 100.0, 1000.0])


def test_a_latin_hypercube_has_one_sample_in_each_stratum() -> None:
    of = study(
        parameters={
            BASE: {"low": 0.0, "high": 8.0},
            PRE: {"low": 1.0, "high": 256.0, "log": True},
        },
        drawn={"count": 8, "seed": 2},
    )
    found = trials(of)
    assert sorted(int(each.parameters[BASE]) for each in found) == list(range(8))
    assert all(1.0 <= each.parameters[PRE] <= 256.0 for each in found)
    assert trials(of) == found
    other = of.model_copy(update={"drawn": of.drawn.model_copy(update={"seed": 3})})  # type: ignore[union-attr]
    assert trials(other) != found


def test_shares_are_the_whole_and_each_run_is_in_one() -> None:
    every = trials(study(seeds=11))
    parts = [share(every, number, 4) for number in (1, 2, 3, 4)]
    assert sorted(each.index for part in parts for each in part) == [each.index for each in every]
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_a_run_is_repeated_by_one_command() -> None:
    of = study(
        duration=0.5,
        controllers=["pid"],
        overrides={"recording.raw_frames": False},
        parameters={"lab.noise.tracker.latency_ms": [[4.0, 10.0]]},
    )
    assert trials(of)[0].command(of) == (
        "tonus run config/direct.yaml --virtual --force --scenario hold --seed 1 --duration 0.5 "
        "--controller pid --set recording.raw_frames=false "
        "--set 'lab.noise.tracker.latency_ms=[4.0, 10.0]'"
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"parameters": {BASE: {"low": 1.0, "high": 2.0}}}, "drawn: {count: N} is needed"),
        ({"drawn": {"count": 3}}, "no parameter has a range"),
        ({"parameters": {BASE: [1.0]}, "overrides": {BASE: 2.0}}, "parameters and overrides"),
        ({"parameters": {BASE: {"low": 2.0, "high": 1.0, "steps": 2}}}, "2 to 1"),
        ({"parameters": {BASE: []}}, "parameters"),
        ({"seeds": 0}, "seeds"),
        ({"configs": []}, "configs"),
        ({"nonsense": 1}, "nonsense"),
    ],
)
def test_a_wrong_study_is_one_line_with_its_place(
    change: dict[str, Any], told: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(json.dumps(MINIMAL | change))
    with pytest.raises(ConfigError) as caught:
        load_parameter_study(path)
    assert told in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"shown": ["tracking_rms"]}, "did you mean tracking_rms_mm?"),
        ({"measures": {"k": {"topic": "stiffness", "field": "keq", "take": "mean"}}}, "k_eq"),
        ({"parameters": {"control.stiffness.bas": [1.0]}}, "control.stiffness.bas"),
        ({"parameters": {BASE: [3210.0, float("nan")]}}, f"parameters.{BASE}: input should be"),
        ({"parameters": {BASE: [float("nan"), 3210.0]}}, f"parameters.{BASE}: input should be"),
        (
            {"parameters": {BASE: {"low": -1.0, "high": 3210.0}}, "drawn": {"count": 2}},
            f"parameters.{BASE}: input should be greater than 0, not -1.0; choose a larger value",
        ),
        ({"configs": ["nowhere.yaml"]}, "nowhere.yaml"),
        ({"scenarios": ["hold", "hole"]}, "hole"),
    ],
)
def test_what_a_study_names_is_looked_for_before_its_first_run(
    change: dict[str, Any], told: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(json.dumps(MINIMAL | change))
    out = tmp_path / "out"
    done = CliRunner().invoke(tonus, ["campaign", str(path), "--out", str(out)])
    assert done.exit_code != 0
    assert told in str(done.exception)
    assert not out.exists()


def test_values_that_fit_only_together_are_judged_by_their_runs(tmp_path: Path) -> None:
    """With the first minimum no base would do."""
    path = tmp_path / "study.yaml"
    both = {"control.stiffness.minimum": [5000.0, 420.0], BASE: [3210.0, 3300.0]}
    path.write_text(json.dumps(MINIMAL | {"parameters": both}))
    done = CliRunner().invoke(tonus, ["campaign", str(path), "--count"])
    assert "parameters." not in str(done.exception)


@pytest.mark.parametrize("text", ["0/2", "3/2", "1/0", "1", "a/b"])
def test_a_share_that_is_none_is_refused(text: str) -> None:
    done = CliRunner().invoke(tonus, ["campaign", "stiffness_law", "--shard", text])
    assert done.exit_code == 2
    assert "write I/N" in done.output


def test_a_study_counts_its_runs() -> None:
    done = CliRunner().invoke(tonus, ["campaign", "stiffness_law", "--count"])
    assert done.exit_code == 0
    assert done.output.startswith("180 runs; the first: tonus run config/direct.yaml")


def test_files_of_a_study_lie_beside_it(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("")
    path = tmp_path / "study.yaml"
    path.write_text(json.dumps(MINIMAL | {"configs": ["mine.yaml", "config/can.yaml"]}))
    assert load_parameter_study(path).configs == (str(tmp_path / "mine.yaml"), "config/can.yaml")


def test_the_table_has_a_column_for_each_parameter_and_the_same_bytes_again(tmp_path: Path) -> None:
    of = study(seeds=2, parameters={BASE: [1.0, 2], "control.filter": ["a", None], PRE: [[1, 2]]})
    rows = [row(of, each, None if each.index == 0 else 0.5) for each in trials(of)]
    path = write_table(of, rows, tmp_path)
    first = path.read_bytes()
    table = pyarrow.parquet.read_table(path).to_pydict()
    assert table[BASE] == [1.0] * 4 + [2.0] * 4
    assert table["control.filter"][:4] == ["a", "a", None, None]
    assert table[PRE][0] == "[1, 2]"
    assert table["tracking_rms_mm"][:2] == [None, 0.5]
    assert write_table(of, rows, tmp_path).read_bytes() == first


def test_means_leave_failed_runs_out_and_say_so() -> None:
    of = study(seeds=4, parameters={BASE: [1.0]})
    planned = trials(of)
    rows = [row(of, each, float(each.index)) for each in planned[:3]]
    rows.append(failed(of, planned[3], "broken"))
    (group,) = groups(of, rows)
    mean = group.mean("tracking_rms_mm")
    assert mean is not None
    assert (mean.count, mean.value, group.bad) == (3, 1.0, 1)
    # t(0.975, 2) = 4.3027, of three values at a distance of one
    assert mean.half == pytest.approx(4.3027 / 3**0.5, rel=1e-4)


def test_shares_of_different_studies_and_missing_runs_are_refused(tmp_path: Path) -> None:
    of, other = study(seeds=3), study(seeds=4)
    for name, whose, numbers in (("a", of, [0]), ("b", of, [1, 2]), ("c", other, [3])):
        with Journal(tmp_path / name, head(whose), resume=True, name=JOURNAL, anew=ANEW) as journal:
            for index in numbers:
                journal.add(row(whose, trials(whose)[index]))
    _, rows = merged([tmp_path / "b", tmp_path / "a"])
    assert [each["index"] for each in rows] == [0, 1, 2]
    with pytest.raises(ToolError, match="1 of 3 trials have no row, the first is number 0"):
        merged([tmp_path / "b"])
    with pytest.raises(ToolError, match="another study"):
        merged([tmp_path / "a", tmp_path / "c"])
    with pytest.raises(ToolError, match="is no journal of a study"):
        merged([tmp_path / "nowhere"])


def test_parameters_of_like_names_stay_apart() -> None:
    told, true = "tracker.latency_ms", "lab.noise.tracker.latency_ms"
    of = study(parameters={told: [8.0, 12.0], true: [[4.0, 10.0], [8.0, 8.0]], BASE: [3000.0]})
    found = groups(of, [row(of, each) for each in trials(of)])
    assert len(found) == 4
    assert list(found[0].labels) == [told, "noise.tracker.latency_ms", "stiffness.base"]


def test_a_controller_of_ones_own_is_told_by_its_class_unless_two_have_that_name() -> None:
    own, other = "tonus.runtime.control.controllers.pid:PidAtRest", "laboratory.gains:PidAtRest"
    for controllers, told in ((["pid", own], ["pid", "PidAtRest"]), ([own, other], [own, other])):
        of = study(controllers=controllers)
        rows = [row(of, each) for each in trials(of)]
        assert sorted({each.labels["controller"] for each in groups(of, rows)}) == sorted(told)
        (less,) = {each.labels["controller"] for each in differences(of, rows)}
        assert less == f"{told[1]} less {told[0]}"


def test_rows_of_a_configuration_that_was_edited_are_not_taken(tmp_path: Path) -> None:
    """Of one's own file: the code's digest covers the shipped ones."""
    mine = tmp_path / "mine.yaml"
    mine.write_text((HERE / "direct.yaml").read_text().replace("!include ", f"!include {HERE}/"))
    of = study(configs=[str(mine)])
    with Journal(tmp_path, head(of), resume=True, name=JOURNAL, anew=ANEW) as journal:
        journal.add(row(of, trials(of)[0]))
    mine.write_text(mine.read_text() + "set: {control.stiffness.base: 3000.0}\n")
    with pytest.raises(ToolError, match="another configuration"):
        Journal(tmp_path, head(of), resume=True, name=JOURNAL, anew=ANEW)


def test_an_error_that_nobody_foresaw_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError("of mine")

    monkeypatch.setattr("tonus.tools.study.play.run", broken)
    of = study()
    made = play(of, trials(of)[0], tmp_path / "run")
    assert made["verdict"] == "error"
    assert made["reason"].startswith("ZeroDivisionError: of mine (test_study.py:")


@pytest.mark.parametrize(("seeds", "sure"), [(1, False), ([4], False), (2, True), ([4, 5], True)])
def test_one_seed_gives_no_confidence(tmp_path: Path, seeds: Any, *, sure: bool) -> None:
    of = study(seeds=seeds)
    page = write_page(of, [row(of, each) for each in trials(of)], tmp_path).read_text()
    assert ("with 95 % confidence" in page) is sure
    assert ("one each, so without a confidence" in page) is not sure


def test_nothing_of_a_row_is_markup_on_the_page(tmp_path: Path) -> None:
    of = study(
        controllers=["bio", "pid"], parameters={BASE: [1.0, 2.0]}, pareto=["effort_rms_nm"] * 2
    )
    rows = [row(of, each) for each in trials(of)]
    rows[0] |= {"verdict": "error", "reason": "<script>alert(1)</script>"}
    page = write_page(of, rows, tmp_path).read_text()
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert write_page(of, rows, tmp_path).read_text() == page


def test_what_a_study_costs_beside_its_runs() -> None:
    """`make bench-studies`, in a short form; through Dask it is a long test."""
    cost = study_scale.local(20)
    assert cost.trials == 20
    assert str(cost).count("|") == study_scale.HEAD.splitlines()[0].count("|")


@pytest.mark.long
def test_what_a_study_costs_through_dask() -> None:
    pytest.importorskip("distributed", reason="pip install 'tonus[study]'")
    assert study_scale.dask(200).trials == 200
