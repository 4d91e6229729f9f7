"""Episodes played in forks: the same bits as without, and no child's end is the campaign's."""

from __future__ import annotations

import json
import os
import signal
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from tests.command import command
from tests.wrong_daemons import after, opposite
from tonus.config.loader import load_scenario, load_study
from tonus.config.schema.scenario import Scenario
from tonus.drivers.exchange import Exchange
from tonus.tools.campaign.draw import begins, grouped, undisturbed
from tonus.tools.campaign.episode import Episode, Setup
from tonus.tools.campaign.invariants import within_bounds
from tonus.tools.campaign.judge import digest, row_of
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import play
from tonus.tools.campaign.players import play as played

STUDY = load_study("faults")
FAULTS: dict[str, dict[str, Any]] = {
    "direct": {"kind": "cable_cut", "axis": 2},
    "can": {"kind": "unplug", "channel": "can1", "node": 3},
    "ethercat": {"kind": "drive_error", "channel": "tonus0", "node": 4, "code": 0x2310},
}
SUPERVISED = {
    "direct": None,
    "can": {"there": True, "stops": []},
    "ethercat": {"there": True, "stops": []},
}
UNDISTURBED = [
    pytest.param(controller, name, marks=[] if number in (0, 3) else pytest.mark.long)
    for number, (controller, name) in enumerate(
        zip(STUDY.controllers, STUDY.scenarios * 8, strict=False)
    )
]
"""`make test` plays the first one and one in contact; `test_campaign_at_random.py` has the others,
with faults"""


def episode(bus: str, index: int, *, at: float, stop: float, name: str = "hold") -> Episode:
    """A fault and an operator's stop, where the bus has one."""
    overrides = STUDY.overrides | STUDY.bus_overrides.get(bus, {})  # type: ignore[call-overload]
    setup = Setup(config=f"config/{bus}.yaml", seed=5, overrides=overrides)
    data = undisturbed(STUDY, setup, load_scenario(name)).model_dump()
    trunk = Scenario.model_validate(data)
    fault = FAULTS[bus]
    data["lab"]["faults"] = [fault | {"at": at}] if fault else []
    started = data["operator"][0]["at"]
    kept = data["operator"] if started < stop else ()
    data["operator"] = [*kept, {"at": stop, "command": "stop"}]
    scenario = Scenario.model_validate(data)
    return Episode(
        setup=setup, scenario=scenario, begins=begins(trunk, scenario), index=index, state="ACTIVE"
    )


def rows(todo: list[Episode], **options: Any) -> dict[int, dict[str, Any]]:
    return {row["index"]: row for row in played(grouped(STUDY, todo), STUDY, 2, **options)}


@pytest.mark.wide
@pytest.mark.parametrize(
    "bus", ["direct", *(pytest.param(bus, marks=pytest.mark.long) for bus in ("can", "ethercat"))]
)
def test_a_forked_episode_is_bit_equal_to_one_from_off(bus: str) -> None:
    todo = [
        episode(bus, 1, at=3.0, stop=3.3, name="sine_x"),
        episode(bus, 2, at=1.5, stop=1.6, name="sine_x"),
    ]
    found = rows(todo)
    for each in todo:
        seen = play(each, tail=STUDY.times.tail, longest=STUDY.times.longest)
        assert seen.error == ""
        assert found[each.index]["digest"] == digest(seen), each.index
        assert found[each.index]["ticks"] == len(seen.cycle_ns)
        assert found[each.index]["supervisor"] == SUPERVISED[bus]


@pytest.mark.wide
def test_an_episode_shows_what_its_supervisor_did(monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon is changed here; no bound is broken yet, so the stop counts as one too many."""
    ticks = count()

    def late(result: Any, *_: Any) -> Any:
        words, torques = result
        return (words, opposite(torques.copy())) if next(ticks) > 3000 else result

    after(Exchange, "commands", late)(monkeypatch)
    each = episode("can", 1, at=9.0, stop=3.0)
    seen = play(each, tail=STUDY.times.tail, longest=STUDY.times.longest)
    found = row_of(each, seen, replayed=False)
    (stop,) = found["supervisor"]["stops"]
    assert stop["requirement"] == "SUP-10"
    assert [name["invariant"] for name in found["violations"]][:1] == ["supervisor"]


def dying(run: Observed) -> None:
    """Takes the place of an allowance, in the child."""
    number = {3.0: signal.SIGSEGV, 3.1: signal.SIGPROF}.get(run.scenario.operator[-1].at)
    if number is not None:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    if run.scenario.operator[-1].at == 3.2:
        raise ZeroDivisionError


@pytest.mark.wide
def test_a_child_that_dies_is_a_row() -> None:
    stops = (3.0, 3.1, 3.2, 3.3)
    found = rows(
        [episode("direct", n, at=9.0, stop=stop) for n, stop in enumerate(stops, 1)],
        allowance=dying,
    )
    assert [found[n]["reason"] for n in (1, 2)] == [
        "crashed: SIGSEGV",
        f"hung: no end in {STUDY.times.hang} s of processor time",
    ]
    assert found[3]["reason"].startswith("crashed")
    assert (found[4]["state"], found[4]["violations"]) == ("STANDBY", [])
    assert all(found[n]["violations"][0]["invariant"] == "exception" for n in (1, 2, 3))


def test_a_setup_that_cannot_be_played_is_a_row_for_each_episode() -> None:
    todo = [episode("direct", n, at=9.0, stop=3.0 + 0.1 * n) for n in (1, 2)]
    wrong = {"control.sequence.referencing_spread": 1e-9}
    setup = todo[0].setup.model_copy(update={"overrides": dict(STUDY.overrides) | wrong})
    found = rows([each.model_copy(update={"setup": setup}) for each in todo])
    assert sorted(found) == [1, 2]
    assert all(found[n]["violations"] for n in (1, 2))


@pytest.mark.parametrize(("controller", "name"), UNDISTURBED)
def test_without_a_fault_no_bound_is_broken(controller: str, name: str) -> None:
    each = episode("direct", 1, at=9.0, stop=4.0, name=name)
    overrides = dict(each.setup.overrides) | {"control.controller": controller}
    each = each.model_copy(update={"setup": each.setup.model_copy(update={"overrides": overrides})})
    seen = play(each, tail=STUDY.times.tail, longest=STUDY.times.longest)
    assert within_bounds(seen) == []


@pytest.mark.wide
def test_the_command_goes_on_where_it_was_left(tmp_path: Path) -> None:
    line = ("campaign", "faults", "--bus", "direct", "--out", str(tmp_path), "--minimise", "0")
    campaign = partial(command, *line)
    first = campaign("--episodes", "1", "--json")
    assert first.code in (0, 1), first.err
    assert json.loads(first.out)["episodes"] == 1
    second = campaign("--episodes", "2", "--resume", "--json")
    assert json.loads(second.out)["episodes"] == 2, second.err
    journal = (tmp_path / "episodes.jsonl").read_text().splitlines()
    assert [json.loads(line).get("index") for line in journal] == [None, 0, 1]
    other = campaign("--episodes", "2", "--resume", "--seed", "2")
    assert other.code == 2
    assert "another seed" in other.err
    assert len(other.err.splitlines()) == 1
    assert campaign("--episodes", "0").code == 2
