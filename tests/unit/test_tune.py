"""Tuning: the search under a made-up cost, the landing in files, and a tiny run of the command."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import threading
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from tonus import config as config_room
from tonus.config import load
from tonus.config.loader import load_tuning
from tonus.config.schema.tuning import Tuning
from tonus.tools.cli.tune import tune
from tonus.tools.errors import ToolError
from tonus.tools.margins.task import margins
from tonus.tools.tune.judge import Part, lack
from tonus.tools.tune.landing import land
from tonus.tools.tune.search import Found, Search
from tonus.tools.tune.work import Evaluator, Gains, _work

CONFIG = "config/direct.yaml"
TUNING = load_tuning()
TINY = """
seed: 1
evaluations: 2
population: 5
failure: 100.0
cost:
  position: {weight: 1.0, scale: 1.0e-3}
  force: {weight: 1.0, scale: 1.0}
  effort: {weight: 0.0, scale: 1.0}
overrides:
  control.sequence.tare_s: 0.05
  control.sequence.referencing_settle_s: 0.6
  control.sequence.referencing_average_s: 0.25
  control.sequence.pretension_s: 0.4
  control.sequence.lift_s: 0.8
scenarios:
  - {name: still, description: Nothing, duration: 0.1, reference: {kind: hold}}
tension_loop:
  seed: 1
  evaluations: 40
  reserve: 1.1
  seconds: 0.5
  proportional: {low: 1.0, high: 50.0}
  integral: {low: 10.0, high: 500.0}
  damping_rate: {low: 10.0, high: 500.0}
  lead: {low: 0.1, high: 1.0}
controllers:
  pd: {pd.stiffness: {low: 2000.0, high: 4000.0}}
"""


class MadeUp:
    """A cost with its least at known gains, in place of the simulations."""

    simulated = 0

    def __init__(self, least: Gains) -> None:
        self._least = least
        self.seen: list[Gains] = []

    def __call__(self, controller: str, many: Sequence[Gains]) -> list[list[Part]]:
        self.seen += many
        return [[Part("made up", self._cost(gains), None, None, 0.0)] for gains in many]

    def _cost(self, gains: Gains) -> float:
        return sum(math.log(value / self._least[key]) ** 2 for key, value in gains.items())


def searched(controller: str, evaluator: object, tuning: Tuning = TUNING) -> Found:
    return Search(CONFIG, tuning, controller, evaluator, lambda *_: None).run()  # type: ignore[arg-type]


@pytest.fixture
def without_floors(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of the search alone: margins are most of its own time."""
    monkeypatch.setattr("tonus.tools.tune.search.lack", lambda *_: 0.0)


@pytest.mark.usefixtures("without_floors")
def test_it_comes_near_the_least_cost_with_its_budget_and_no_more() -> None:
    made_up = MadeUp({"pd.stiffness": 2500.0, "pd.damping_ratio": 0.6})
    found = searched("pd", made_up)
    assert 0 < len(made_up.seen) == found.evaluations <= TUNING.evaluations
    assert found.before is not None
    assert found.cost < 0.1 * found.before
    pd = load(CONFIG)[0].control.pd
    begun = {"pd.stiffness": pd.stiffness, "pd.damping_ratio": pd.damping_ratio}
    assert made_up.seen[0] == begun, "begins as it is"


@pytest.mark.usefixtures("without_floors")
def test_the_same_seed_finds_the_same_and_another_does_not() -> None:
    least = {"pd.stiffness": 2500.0, "pd.damping_ratio": 0.6}
    short = TUNING.model_copy(update={"evaluations": 12})
    first, same = (searched("pd", MadeUp(least), short) for _ in range(2))
    assert first == same
    other = searched("pd", MadeUp(least), short.model_copy(update={"seed": 2}))
    assert other.gains != first.gains


@pytest.mark.long
def test_no_simulation_is_spent_on_gains_below_the_floors() -> None:
    """The made-up cost is least where a wild integral leaves no margin."""
    made_up = MadeUp(
        {"pid.stiffness": 4800.0, "pid.damping_ratio": 0.35, "pid.integral.gain": 9.0e4}
    )
    short = TUNING.model_copy(update={"evaluations": 16})
    found = searched("pid", made_up, short)
    floors = load(CONFIG)[0].control.tension_loop
    assert found.refused > 0
    assert len(made_up.seen) <= short.evaluations
    for gains in (*made_up.seen[:: TUNING.population], found.gains):
        tuned, _ = load(CONFIG, overrides={f"control.{k}": v for k, v in gains.items()})
        for cut in ("torque", "force"):
            kept = margins(tuned, "pid", cut=cut)
            assert kept.gain_db >= floors.gain_margin_db
            assert kept.phase_deg >= floors.phase_margin_deg


def test_an_unstable_loop_lacks_more_than_one_that_is_merely_below_the_floor() -> None:
    wild, _ = load(CONFIG, overrides={"control.pid.integral.gain": 1.0e6})
    weak, _ = load(CONFIG, overrides={"control.pid.integral.gain": 9.0e4})
    good, _ = load(CONFIG)
    assert lack(good, "pid") == 0.0 < lack(weak, "pid") < lack(wild, "pid")


def test_every_controller_with_gains_is_there_to_be_tuned_and_starts_inside_its_ranges() -> None:
    control = load(CONFIG)[0].control.model_dump()
    assert set(TUNING.controllers) == {
        *("bio", "bio_integral", "bio_observer", "pd", "pd_matched", "pid", "pid_length", "force")
    }
    for ranges in TUNING.controllers.values():
        for key, span in ranges.items():
            value = control
            for part in key.split("."):
                value = value[part]
            assert span.low <= value <= span.high, key  # type: ignore[operator]


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A copy of the configuration that may be written to."""
    source = Path(config_room.__file__).parent
    folder = tmp_path / "own"
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.py", "__pycache__", "schema"))
    return folder


def test_gains_land_in_the_file_that_has_them_and_leave_the_rest_of_it(own: Path) -> None:
    before = (own / "control.yaml").read_text()
    gains = {"pid.integral.gain": 12345.0, "pd.damping_ratio": 0.71, "force.damping": 90.0}
    assert land(str(own / "direct.yaml"), gains) == [own / "control.yaml"]
    control = load(own / "direct.yaml")[0].control
    assert control.pid.integral.gain == 12345.0
    assert (control.pd.damping_ratio, control.force.damping) == (0.71, 90.0)
    after = (own / "control.yaml").read_text()
    changed = [
        (old, new)
        for old, new in zip(before.splitlines(), after.splitlines(), strict=True)
        if old != new
    ]
    assert len(changed) == 3
    assert all(old.partition("#")[2] == new.partition("#")[2] for old, new in changed)


def test_a_gain_that_stands_nowhere_changes_nothing(own: Path) -> None:
    text = (own / "control.yaml").read_text()
    text, replaced = re.subn(r"\nbio: \{damping_ratio: [^}]*\}", "\nbio: {}", text)
    assert replaced == 1
    (own / "control.yaml").write_text(text)
    with pytest.raises(ToolError, match=r"control\.bio\.damping_ratio"):
        land(str(own / "direct.yaml"), {"pid.stiffness": 3000.0, "bio.damping_ratio": 0.9})
    assert (own / "control.yaml").read_text() == text


@pytest.mark.long
def test_a_tiny_run_writes_gains_with_their_provenance_and_is_not_done_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rules, out = tmp_path / "tiny.yaml", tmp_path / "new" / "tuned.yaml"
    rules.write_text(TINY)
    order = ["pd", "--tuning", str(rules), "--out", str(out), "--jobs", "1", "--json"]
    done = CliRunner().invoke(tune, order, catch_exceptions=False)
    result = json.loads(done.stdout)
    assert yaml.safe_load(out.read_text()) == result
    row = result["controllers"]["pd"]
    assert row["evaluations"] == result["evaluations"] == 2
    assert 0.0 < row["cost"] <= row["cost_before"] < 1.0
    assert row["margins"]["torque"]["phase_deg"] >= 35.0
    assert "fault" not in row["scenarios"]["still"]
    first = out.read_bytes()

    def never(order: object) -> list[Part]:
        raise AssertionError("what the journal knows is not simulated again")

    monkeypatch.setattr("tonus.tools.tune.work._work", never)
    CliRunner().invoke(tune, order, catch_exceptions=False)
    assert out.read_bytes() == first


def test_a_line_cut_short_in_the_journal_is_simulated_again(tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    evaluator = Evaluator(CONFIG, None, 1, journal, 1)
    part = {"scenario": "s", "cost": 1.0, "position": None, "force": None, "effort": 0.0}
    line = {"for": evaluator.fingerprint, "key": "k", "parts": [part]}
    other = {**line, "for": "another", "key": "o"}
    journal.write_text(json.dumps(line) + "\n" + json.dumps(other) + "\n" + '{"for": "')
    known = Evaluator(CONFIG, None, 1, journal, 1)._known
    assert known == {"k": [Part(**part)]}


def made_up(order: tuple[str, str | None, int, str, Gains]) -> list[Part]:
    """In place of a simulation; the first takes longest."""
    stiffness = order[4]["pd.stiffness"]
    threading.Event().wait(0.05 if stiffness < 2100.0 else 0.0)
    if stiffness == 2666.0:
        os.kill(os.getpid(), signal.SIGKILL)
    if stiffness == 2777.0:
        raise ZeroDivisionError("in a model")
    return [Part("s", stiffness, 0.1 + 0.2, None, float(os.getpid()))]


def gains_of(*stiffness: float) -> list[Gains]:
    return [{"pd.stiffness": each} for each in stiffness]


@pytest.fixture
def evaluator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Evaluator:
    monkeypatch.setattr("tonus.tools.tune.work._work", made_up)
    monkeypatch.setattr("tonus.tools.tune.work.warm_up", lambda _: None)
    return Evaluator(CONFIG, None, 1, tmp_path / "journal", 2)


def test_evaluations_are_done_in_processes_and_given_in_order(evaluator: Evaluator) -> None:
    many = gains_of(2000.0, 2200.0, 2300.0, 2200.0)
    found = evaluator("pd", many)
    assert [parts[0].cost for parts in found] == [2000.0, 2200.0, 2300.0, 2200.0]
    assert found[0][0].position == 0.1 + 0.2
    assert len({parts[0].effort for parts in found} - {float(os.getpid())}) == 3
    assert evaluator.simulated == 3
    assert evaluator("pd", many) == found
    assert evaluator.simulated == 3


@pytest.mark.parametrize(
    ("bad", "words"),
    [(2666.0, "crashed: SIGKILL; what was simulated"), (2777.0, "ZeroDivisionError: in a model")],
)
def test_an_evaluation_that_cannot_be_done_is_named_and_costs_no_other(
    evaluator: Evaluator, tmp_path: Path, bad: float, words: str
) -> None:
    with pytest.raises(ToolError) as told:
        evaluator("pd", gains_of(2200.0, 2300.0, bad, 2400.0, 2500.0))
    assert f"pd with pd.stiffness {bad:g}: {words}" in str(told.value)
    assert "\n" not in str(told.value)
    again = Evaluator(CONFIG, None, 1, tmp_path / "journal", 2)
    assert again._known  # the third began when one of the first two was done
    found = again("pd", gains_of(2200.0, 2300.0, 2500.0))
    assert [parts[0].cost for parts in found] == [2200.0, 2300.0, 2500.0]
    assert again.simulated < 3


@pytest.mark.wide
def test_an_evaluation_is_the_same_in_a_process_of_its_own(tmp_path: Path) -> None:
    rules = tmp_path / "tiny.yaml"
    rules.write_text(TINY)
    many = gains_of(2000.0, 3500.0)
    found = Evaluator(CONFIG, str(rules), 1, tmp_path / "journal", 2)("pd", many)
    assert found == [_work((CONFIG, str(rules), 1, "pd", gains)) for gains in many]


@pytest.mark.parametrize(
    ("order", "told"),
    [
        (["eq9_literal"], "nothing to tune"),
        (["pid", "--config", "config/can.yaml"], "direct"),
        (["pid", "--tuning", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_what_cannot_be_tuned_is_told_in_a_line(order: list[str], told: str) -> None:
    raised = CliRunner().invoke(tune, order).exception
    assert raised is not None
    assert told in str(raised)
    assert "\n" not in str(raised)
