"""The shipped study of the six indicators in a short form: two robots, one seed."""

from __future__ import annotations

from typing import Any

import pytest
from loop import QUICK

from tonus.config.loader import load_parameter_study
from tonus.config.schema.parameter_study import ParameterStudy, Steps
from tonus.tools.paper.case import Case, Run
from tonus.tools.paper.conduct import conduct
from tonus.tools.paper.metrics import measure
from tonus.tools.paper.recorded import kind_of
from tonus.tools.study.engine import carry_out
from tonus.tools.study.groups import ROBOT, differences
from tonus.tools.study.indicators import INDICATORS
from tonus.tools.study.play import COMPLETED, Row
from tonus.tools.study.provenance import loaded
from tonus.tools.study.trials import trials

pytestmark = pytest.mark.wide


@pytest.fixture(scope="module")
def study() -> ParameterStudy:
    """The steps of 10 mm and the sine alone, which the bring-up's length does not shift."""
    shipped = load_parameter_study("six_indicators")
    short: dict[str, Any] = {
        "seeds": 1,
        "scenarios": ("paper_move", "paper_sine"),
        "overrides": shipped.overrides | QUICK,
        "parameters": {ROBOT: Steps(low=1001, high=1002, steps=2, whole=True)},
    }
    return shipped.model_copy(update=short)


@pytest.fixture(scope="module")
def rows(study: ParameterStudy, tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    return carry_out(study, tmp_path_factory.mktemp("six"), workers=1).rows


def test_every_run_is_completed_and_has_the_indicators_of_its_test(
    study: ParameterStudy, rows: list[Row]
) -> None:
    assert [row["verdict"] for row in rows] == [COMPLETED] * (2 * 3 * 2)
    of_moves, of_sines = {"settling", "overshoot_percent"}, {"energy_per_period"}
    for row in rows:
        has = {name for name in study.indicators if row[name] is not None}
        if row["scenario"] == "paper_sine":
            assert has == of_sines | {"efficiency_percent"}
        else:
            assert {"overshoot_percent"} <= has <= of_moves
    assert len({row["digest"] for row in rows}) == len(rows), "each robot is another one"


def test_they_are_those_of_the_papers_programme_bit_for_bit(
    study: ParameterStudy, rows: list[Row]
) -> None:
    """Which conducts a test in memory, without a log and without the way down."""
    planned = trials(study)
    for trial in (planned[5], planned[-1]):
        config, scenario = loaded(study, trial)
        case = Case(0, scenario.name, kind_of(scenario), scenario)
        run = Run(case, "", "", trial.seed, "direct")
        told = measure(conduct(run, config))
        row = rows[trial.index]
        for name in study.indicators:
            if case.kind in INDICATORS[name]:
                assert row[name] == told[name], name


def test_the_lower_tone_alone_takes_what_bio_observer_saves(
    study: ParameterStudy, rows: list[Row]
) -> None:
    saved = {}
    for group in differences(study, rows):
        mean = group.mean("energy_per_period")
        if mean is not None:
            saved[group.labels["controller"]] = mean.value
    assert saved.keys() == {
        "PidAtRest less pid",
        "bio_observer less pid",
        "bio_observer less PidAtRest",
    }
    assert saved["PidAtRest less pid"] < -2.0
    assert saved["bio_observer less pid"] < -2.0
    assert abs(saved["bio_observer less PidAtRest"]) < 0.5
