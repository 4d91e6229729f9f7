"""Episodes as they are drawn, kept and reduced: nothing is played here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from tonus.config import ConfigError
from tonus.config.faults import KINDS
from tonus.config.loader import load_study
from tonus.config.schema.campaign import BusName, Study
from tonus.tools.campaign import regression
from tonus.tools.campaign.campaign import carry_out
from tonus.tools.campaign.coverage import Pairs
from tonus.tools.campaign.draw import begins, episodes, grouped, undisturbed
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.journal import Journal
from tonus.tools.campaign.minimise import reduced
from tonus.tools.campaign.places import places
from tonus.tools.campaign.table import STATES, lines, table
from tonus.tools.errors import ToolError

STUDY = load_study("faults")
BUSES: tuple[BusName, ...] = get_args(BusName)
DRAWN = episodes(STUDY, 3, ["can"], 96)


def test_every_kind_of_fault_is_drawn_or_excluded_with_a_reason() -> None:
    assert set(STUDY.kinds) | set(STUDY.excluded_kinds) == set(KINDS)
    assert not set(STUDY.kinds) & set(STUDY.excluded_kinds)
    data = STUDY.model_dump()
    del data["kinds"]["loss"]
    with pytest.raises(ValidationError, match="loss is not listed"):
        Study.model_validate(data)


def test_every_controller_is_drawn_or_excluded_with_a_reason() -> None:
    from tonus.runtime.control.controllers import CONTROLLERS

    assert set(STUDY.controllers) | set(STUDY.excluded_controllers) == set(CONTROLLERS)


@pytest.mark.parametrize(
    ("kind", "wrong", "words"),
    [("loss", {"probability_": {"low": 0, "high": 1}}, "has no"), ("lossy", {}, "there is no")],
)
def test_a_study_draws_what_there_is(kind: str, wrong: dict[str, Any], words: str) -> None:
    data = STUDY.model_dump()
    data["kinds"][kind] = {"values": wrong}
    with pytest.raises(ValidationError, match=words):
        Study.model_validate(data)


def test_buses_with_a_supervisor_have_its_times_of_a_robot() -> None:
    """Without it nothing is armed; elsewhere there is none."""
    for bus in ("can", "ethercat"):
        for each in episodes(STUDY, 3, [bus], 2):
            found = each.setup.settle().supervisor
            assert found is not None
            assert (found.policy, found.period_ms, found.timeout_ms) == ("require", 2, 22)
            assert found.patience_ms == 5.0
    (alone,) = episodes(STUDY, 3, ["direct"], 1)
    assert not [key for key in alone.setup.overrides if "supervisor" in key]


def test_an_unknown_study_is_one_line() -> None:
    with pytest.raises(ConfigError, match="did you mean faults"):
        load_study("fault")


@pytest.mark.parametrize("bus", BUSES)
def test_the_same_seed_draws_the_same_and_more_only_adds(bus: BusName) -> None:
    few, many = episodes(STUDY, 5, [bus], 15), episodes(STUDY, 5, [bus], 30)
    assert many[:15] == few
    assert episodes(STUDY, 6, [bus], 15) != few
    assert [episode.index for episode in many] == list(range(30))


def test_every_state_and_number_of_faults_is_drawn_and_kinds_are_left_out() -> None:
    assert {episode.state for episode in DRAWN} == set(STATES)
    assert {len(episode.kinds) for episode in DRAWN} == {1, 2, 3}
    assert len({kind for episode in DRAWN for kind in episode.kinds}) > 8


def test_an_episode_ends_with_a_stop_and_begins_before_it_differs() -> None:
    for episode in DRAWN:
        scenario = episode.scenario
        trunk = undisturbed(STUDY, episode.setup, scenario)
        assert scenario.operator[-1].command == "stop"
        assert episode.begins == begins(trunk, scenario)
        assert all(fault.at >= (episode.begins or 0.0) for fault in scenario.lab.faults)
        shared = [each for each in scenario.operator if each.at < (episode.begins or 0.0)]
        assert shared == [each for each in trunk.operator if each.at < (episode.begins or 0.0)]


def test_groups_share_a_bring_up() -> None:
    groups = grouped(STUDY, DRAWN)
    assert sorted(each.index for group in groups for each in group.episodes) == list(range(96))
    assert all(len({each.setup.seed for each in group.episodes}) == 1 for group in groups)
    assert max(len(group.episodes) for group in groups) == STUDY.group


def test_steering_draws_pairs_evenly() -> None:
    def met(steered: float) -> int:
        study = STUDY.model_copy(
            update={"steered": steered, "left_out": 0.0, "states": {"ACTIVE": 1.0}}
        )
        pairs = Pairs()
        for episode in episodes(study, 1, ["can"], 160):
            pairs.add("ACTIVE", episode.kinds)
        kinds = [name for name, kind in STUDY.kinds.items() if "can" in kind.buses]
        return sum(pairs.count("ACTIVE", a, b) > 0 for a in kinds for b in kinds)

    assert met(1.0) > 1.1 * met(0.0)


def test_places_are_those_of_the_bus() -> None:
    can, direct = DRAWN[0].setup.settle(), episodes_of_direct()
    assert {"channel": "can1", "node": 3} in places(can, "drive")
    assert {"channel": "can1", "node": 19} in places(can, "amplifier")
    assert len(places(can, "node")) == 17
    assert places(can, "channel") == [{"channel": f"can{n}"} for n in range(4)]
    assert places(direct, "channel") == []
    assert len(places(direct, "axis")) == len(places(direct, "cable_cell")) == 8
    assert len(places(direct, "cell")) == 9


def episodes_of_direct() -> Any:
    from tonus.config import load

    return load("config/direct.yaml")[0]


# -- kept ----------------------------------------------------------------------------------------

HEAD = {"study": "faults", "seed": 1, "code": "a"}


def row(index: int, **fields: Any) -> dict[str, Any]:
    empty = {"violations": [], "strikes": [], "episode": {}, "supervisor": None}
    return {"index": index} | empty | fields


def test_a_journal_goes_on_behind_its_last_whole_line(tmp_path: Path) -> None:
    with Journal(tmp_path, HEAD, resume=False) as journal:
        journal.add(row(0))
        journal.add(row(1))
    with journal.path.open("ab") as file:
        file.write(b'{"index": 2, "viol')
    with Journal(tmp_path, HEAD, resume=True) as again:
        assert sorted(again.rows) == [0, 1]
        again.add(row(2))
    with Journal(tmp_path, HEAD, resume=True) as last:
        assert sorted(last.rows) == [0, 1, 2]


def test_a_journal_of_another_campaign_is_refused(tmp_path: Path) -> None:
    with Journal(tmp_path, HEAD, resume=False) as journal:
        journal.add(row(0))
    with pytest.raises(ToolError, match="another code"):
        Journal(tmp_path, HEAD | {"code": "b"}, resume=True)
    with Journal(tmp_path, HEAD, resume=False) as anew:
        assert anew.rows == {}


def test_what_is_no_journal_is_said(tmp_path: Path) -> None:
    (tmp_path / "episodes.jsonl").write_text("no\nno\n")
    with pytest.raises(ToolError, match="is no journal"):
        Journal(tmp_path, HEAD, resume=True)


def test_the_table_counts_kinds_invariants_and_pairs() -> None:
    speed = {"invariant": "speed"}
    rows = [
        row(0, strikes=[{"kind": "loss", "state": "ACTIVE"}], violations=[speed, speed]),
        row(
            1,
            strikes=[{"kind": "loss", "state": "ACTIVE"}, {"kind": "delay", "state": "FAULT"}],
            violations=[speed],
        ),
        row(2, strikes=[{"kind": "loss", "state": "HOLD"}]),
        row(
            3,
            strikes=[{"kind": "delay", "state": "SAFE_STOP"}],
            episode={"state": "DESCENT"},
        ),
    ]
    counted = table(STUDY, ["can"], rows)
    assert (counted.episodes, counted.broken, counted.by_invariant["speed"]) == (4, 2, 2)
    loss = counted.by_kind["loss"]
    assert (loss.episodes, loss.broken, loss.alone, loss.broken_alone) == (3, 2, 2, 1)
    assert counted.met("ACTIVE")[0] == 1
    assert counted.singles("DESCENT")[0] == 1
    assert any("loss" in line for line in lines(counted))
    assert counted.as_json()["by_kind"]["loss"]["broken"] == 2


def test_the_table_counts_what_the_supervisor_did() -> None:
    def stop(requirement: str, fault: str) -> dict[str, Any]:
        return {"there": True, "stops": [{"requirement": requirement, "fault": fault}]}

    rows = [
        row(0, supervisor={"there": True, "stops": []}),
        row(1, supervisor=stop("SUP-10", "NONE")),
        row(2, supervisor=stop("SUP-7", "CELL_BAD")),
        row(3, supervisor={"there": False, "stops": []}),
        row(4),
    ]
    counted = table(STUDY, ["can"], rows)
    assert counted.as_json()["supervised"] == 3
    assert counted.as_json()["stopped"] == {"SUP-10": 1, "SUP-7": 1}
    assert counted.as_json()["found_before"] == 1
    assert lines(counted)[1] == (
        "3 were supervised; the supervisor stopped 2 (SUP-10 1, SUP-7 1), 1 after a fault that the "
        "daemon had found"
    )
    assert lines(table(STUDY, ["can"], rows[:1]))[1] == (
        "1 were supervised; the supervisor stopped 0"
    )
    assert "supervis" not in "".join(lines(table(STUDY, ["can"], rows[4:])))


# -- reduced -------------------------------------------------------------------------------------


def test_a_violation_is_reduced_as_far_as_it_holds() -> None:
    episode = next(
        each
        for each in DRAWN
        if len(set(each.kinds)) == 3 and set(STUDY.plants.overrides) <= set(each.setup.overrides)
    )
    guilty = episode.kinds[1]

    def violates(candidates: Sequence[Episode]) -> list[bool]:
        return [guilty in each.kinds for each in candidates]

    simple = reduced(STUDY, episode, violates)
    assert simple.kinds == (guilty,)
    assert not set(STUDY.plants.overrides) & set(simple.setup.overrides)
    assert simple.setup.overrides["control.controller"] == STUDY.controllers[0]
    assert {each.command for each in simple.scenario.operator} <= {"start", "stop"}
    (fault,) = simple.scenario.lab.faults
    assert round(fault.at, 1) == fault.at


def test_a_violation_that_needs_everything_stays() -> None:
    assert reduced(STUDY, DRAWN[0], lambda some: [False] * len(some)) == DRAWN[0]


def test_a_regression_comes_back_from_its_files(tmp_path: Path) -> None:
    path = regression.write(tmp_path, "speed_loss", DRAWN[5], "speed")
    found = regression.load(tmp_path / f"speed_loss{regression.SUFFIX}")
    assert (found.broke, found.setup) == ("speed", DRAWN[5].setup)
    assert found.scenario == DRAWN[5].scenario
    assert path.read_text().startswith("# Broke speed")


def test_what_the_check_refuses_is_not_played(tmp_path: Path) -> None:
    """Before anything is written: its episodes would tell of that, and not of their faults."""
    study = STUDY.model_copy(
        update={
            "configs": {"direct": ("config/six.yaml",)},
            "controllers": ("pd",),
            "scenarios": ("hold",),
        }
    )
    refused = r"study faults: config/six\.yaml with pd in hold: .* floors 6 dB.* leave it out of"
    with pytest.raises(ToolError, match=refused):
        carry_out(study, 1, ["direct"], 1, tmp_path / "out")
    assert not (tmp_path / "out").exists()
