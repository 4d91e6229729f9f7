"""Questions over a log: what they accept, and what they say when a run was otherwise."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from replay.altered import altered

from tonus.config import load
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.states import State
from tonus.tools.campaign.invariants import Violation
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.strikes import NS, Strike
from tonus.tools.errors import ToolError
from tonus.tools.expect import ExpectationError, Run, Signal
from tonus.tools.expect import run as of_runs
from tonus.tools.expect.timeline import Timeline
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.log import Event
from tonus.tools.run.summary import TRUTH

GOLDEN = Path(__file__).parents[1] / "replay" / "golden" / f"v{SCHEMA_VERSION}.mcap"
"""a few ticks of a run, with all of its events"""
TIMELINE = Timeline(0)
NONE = np.zeros(0, np.int64)


class Recorded(Log):
    """The golden log with a warning and a fault."""

    def events(self) -> list[Event]:
        at = self.start_ns
        more = [
            Event(at + 2_450_000_000, 2450, Level.WARNING, "late_pdo", "axis 12", "late"),
            Event(at + 2_480_000_000, 2480, Level.WARNING, "late_pdo", "can0/2 (axis 1)", "late"),
            Event(at + 2_490_000_000, 2490, Level.ERROR, "drive_lost", "can0/2 (axis 1)", "gone"),
        ]
        return sorted([*super().events(), *more], key=lambda event: event.time_ns)


class Loud(Recorded):
    """Long after the fault the host delays a node again and again."""

    def events(self) -> list[Event]:
        at, text = self.start_ns, "late"
        more = [
            Event(
                at + (3000 + 20 * k) * 1_000_000, 3000 + 20 * k, Level.WARNING, "late_pdo", "", text
            )
            for k in range(40)
        ]
        return sorted([*super().events(), *more], key=lambda event: event.time_ns)


@pytest.fixture
def run() -> Run:
    return Run(open_log(GOLDEN))


@pytest.fixture
def disturbed(monkeypatch: pytest.MonkeyPatch) -> Run:
    found = Run(Recorded(GOLDEN))
    struck = Strike("unplug", found.timeline.start_ns + 2_440_000_000)
    monkeypatch.setitem(found.__dict__, "faults", [struck])
    return found


def test_a_run_says_how_it_ended(run: Run) -> None:
    assert (run.state, run.reason) == ("STANDBY", "completed")
    assert run.summary["ticks"] == len(run.log["/tonus/timing"])
    assert Run(run.log, reason="ended by hand").reason == "ended by hand"
    assert run.events[0].text == "OFF to STANDBY"


def test_an_event_is_found_with_its_time(run: Run) -> None:
    found = run.expect("state", where="HOLD to ACTIVE")
    assert found.time == found.after == pytest.approx(2.412)
    assert run.expect("state", after=found.time + 0.001).event.text == "ACTIVE to SAFE_STOP"
    assert run.expect("st?te", where="SAFE_STOP to STANDBY", after=2.0, within=3.0).after > 2.0


def test_an_event_that_is_missing_is_told_with_the_last_ten(run: Run) -> None:
    with pytest.raises(ExpectationError) as caught:
        run.expect("drive_lost", where="axis 1")
    first, head, *lines = str(caught.value).splitlines()
    assert first == caught.value.figure == "no event drive_lost at axis 1"
    assert head == "the last events:"
    assert len(lines) == len(caught.value.events) == 10
    assert lines[-1].strip().startswith("4.616 s  tick   4616  state: SAFE_STOP to STANDBY")


def test_an_event_at_another_place_or_time_is_named(disturbed: Run) -> None:
    with pytest.raises(ExpectationError) as caught:
        disturbed.expect("drive_lost", where="axis 5")
    assert caught.value.figure == (
        "no event drive_lost at axis 5; drive_lost at can0/2 (axis 1) came at 2.490 s"
    )
    with pytest.raises(ExpectationError) as caught:
        disturbed.expect("late*", after=3.0)
    assert caught.value.figure == (
        "no event late* after 3.000 s; late_pdo at axis 12 came at 2.450 s; "
        "late_pdo at can0/2 (axis 1) came at 2.480 s"
    )
    with pytest.raises(ExpectationError) as caught:
        disturbed.expect("state", where="HOLD to FAULT")
    assert caught.value.figure.endswith(" s; 4 more")


def test_a_wildcard_expects_only_what_it_finds(disturbed: Run) -> None:
    assert disturbed.expect("*", after=2.45).event.name == "late_pdo"
    assert [event.name for event in disturbed.unexpected()] == ["drive_lost"]


def test_a_place_is_words_not_letters(disturbed: Run) -> None:
    assert disturbed.expect("late_pdo", where="axis 1").event.tick == 2480
    disturbed.never("late_pdo", where="axis 2")


def test_a_reaction_is_measured_from_the_fault(disturbed: Run) -> None:
    found = disturbed.expect("drive_lost", within=0.05)
    assert found.after == pytest.approx(0.05)
    with pytest.raises(ExpectationError, match=r"came 0\.050 s after 2\.440 s, and not within"):
        disturbed.expect("drive_lost", within=0.04)
    with pytest.raises(ExpectationError, match=r"no event operator after 2\.600 s"):
        disturbed.expect("operator", after=2.6)


def test_an_event_before_the_fault_is_no_reaction_to_it(disturbed: Run) -> None:
    disturbed.expect("state", where="STANDBY to REFERENCING")
    with pytest.raises(ExpectationError, match="no event state"):
        disturbed.expect("state", where="STANDBY to REFERENCING", within=1.0)


def test_what_followed_on_the_fault_is_shown_however_long_the_run_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = Run(Loud(GOLDEN))
    struck = Strike("unplug", found.timeline.start_ns + 2_440_000_000)
    monkeypatch.setitem(found.__dict__, "faults", [struck])
    with pytest.raises(ExpectationError) as caught:
        found.expect("cable_torn", within=0.1)
    figure, head, *lines = str(caught.value).splitlines()
    assert figure == "no event cable_torn after 2.440 s"
    assert re.fullmatch(r"the events from 2\.440 s on, 10 of \d+, errors before others:", head)
    assert len(lines) == 10
    assert [event.name for event in caught.value.events[:3]] == [
        "late_pdo",
        "late_pdo",
        "drive_lost",
    ]
    assert "ERROR drive_lost can0/2 (axis 1): gone" in str(caught.value)
    with pytest.raises(ExpectationError) as caught:
        found.expect("state", where="SAFE_STOP to STANDBY", within=1.0)
    assert "ERROR drive_lost" in str(caught.value), "it is not among the last ten until then"
    assert caught.value.events[-1].text == "SAFE_STOP to STANDBY", "this is what came late"
    with pytest.raises(ExpectationError, match=r"until then:|the last events:") as caught:
        found.expect("cable_torn", after=100.0)
    assert len(caught.value.events) == 10, "there is none from then on"
    with pytest.raises(ExpectationError, match="ERROR drive_lost"):
        found.undisturbed()


def test_what_must_not_happen(disturbed: Run) -> None:
    disturbed.never("bus_off")
    with pytest.raises(ExpectationError, match=r"late_pdo happened at 2\.450 s") as caught:
        disturbed.never("late*")
    assert caught.value.time == pytest.approx(2.45)
    assert caught.value.events[-1].name == "late_pdo"
    assert "the last events until then:" in str(caught.value)


def test_a_warning_that_nobody_expected(disturbed: Run) -> None:
    assert [event.name for event in disturbed.unexpected()] == ["late_pdo"] * 2 + ["drive_lost"]
    assert not disturbed.unexpected(["late_pdo", "drive_*"])
    with pytest.raises(ExpectationError, match=r"3 unexpected .* late_pdo, drive_lost"):
        disturbed.undisturbed()
    disturbed.expect("drive_lost")
    with pytest.raises(ExpectationError, match=r"2 unexpected .* late_pdo\n"):
        disturbed.undisturbed()
    disturbed.allow("late_pdo")
    disturbed.undisturbed()


def test_a_quiet_run_is_undisturbed(run: Run) -> None:
    run.undisturbed()


def test_signals_by_state(run: Run) -> None:
    tension = run.signal("tension", "measured")
    active = tension.during("ACTIVE")
    assert set(active.states) == {State.ACTIVE}
    assert 0 < len(active.times) < len(tension.times)
    active.stays(1.0, 400.0)
    assert active.unit == "N"
    with pytest.raises(ExpectationError, match=r"tension.measured in FAULT: .* no sample"):
        tension.during(State.FAULT)
    with pytest.raises(ToolError, match="no state 'MOVING'"):
        tension.during("MOVING")
    with pytest.raises(ToolError, match=r"^there is no signal /tonus/tension\.colour; it has "):
        run.signal("tension", "colour")
    with pytest.raises(ToolError, match=rf"^{run.path}: there is no signal /elsewhere\.colour; "):
        run.signal("/elsewhere", "colour")


def first_ticks(out: Path, change: float = 0.0) -> Run:
    """The ticks before the first gap; the torque commanded of axis 3 in tick 5 may be another."""

    def edit(topic: str, rows: np.ndarray, sequence: np.ndarray) -> np.ndarray:
        if topic == "/tonus/drives":
            rows["torque_command"][sequence == 5, 3] += change
        return sequence < 8

    return Run(open_log(altered(GOLDEN, out, edit)))


def test_a_log_replays(tmp_path: Path) -> None:
    first_ticks(tmp_path / "same.mcap").replays()
    with pytest.raises(ExpectationError) as caught:
        first_ticks(tmp_path / "other.mcap", 1e-3).replays()
    assert "/tonus/drives.torque_command[3] was" in caught.value.figure
    assert caught.value.figure.endswith("first in tick 5")
    assert caught.value.time == pytest.approx(0.005)


def test_what_cannot_be_replayed_does_not_pass(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ExpectationError, match=r"ticks 46 to 58 .* cannot be replayed") as caught:
        run.replays()
    assert caught.value.time == pytest.approx(0.046)
    run.replays(gaps=True)
    monkeypatch.setattr(Log, "damage", "half of it is missing")
    with pytest.raises(ExpectationError, match="half of it is missing"):
        run.replays(gaps=True)


def test_invariants_need_truth(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Log, "__contains__", lambda _, topic: topic != TRUTH)
    with pytest.raises(ToolError, match="holds no truth"):
        run.invariants()


def test_invariants_are_those_of_the_campaign(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = Observed(*load("config/direct.yaml"), {}, NONE, NONE, NONE, [])
    monkeypatch.setitem(run.__dict__, "_observed", seen)
    monkeypatch.setitem(run.__dict__, "faults", [Strike("loss", 0)])
    broken = Violation("speed", run.log.start_ns / NS + 2.5, 3.0, 1.0, "3 m/s; bound 1")
    asked: list[Observed] = []

    def judge(observed: Observed) -> list[Violation]:
        asked.append(observed)
        return [broken] if len(asked) > 1 else []

    monkeypatch.setattr(of_runs, "within_bounds", judge)
    run.invariants()
    assert asked[0].strikes == [Strike("loss", 0)]
    with pytest.raises(ExpectationError, match="3 m/s; bound 1") as caught:
        run.invariants()
    assert caught.value.time == pytest.approx(2.5)


def signal(values: np.ndarray, unit: str = "N") -> Signal:
    times = np.arange(len(values)) * 0.001

    def fail(figure: str, time: float | None) -> ExpectationError:
        return ExpectationError(figure, timeline=TIMELINE, events=(), time=time)

    return Signal("s", unit, times, values, np.full(len(times), State.HOLD, np.uint8), fail)


def figure(ask: Callable[[], object]) -> tuple[str, float | None]:
    with pytest.raises(ExpectationError) as caught:
        ask()
    return caught.value.figure, caught.value.time


def test_a_signal_stays() -> None:
    values = np.zeros((10, 2))
    values[4, 1], values[6, 0] = 3.0, -9.0
    signal(values).stays(-9.0, 3.0)
    told, time = figure(lambda: signal(values).stays(-1.0, 2.0))
    assert told == (
        "s[1] is 3 N at 0.004 s, which is not in [-1, 2]; farthest s[0] is -9 N at 0.006 s; "
        "2 of 10 samples"
    )
    assert time == pytest.approx(0.004)
    signal(values)[1].stays(0.0, 3.0)
    signal(values).between(0.0, 0.004).stays(0.0, 0.0)
    with pytest.raises(IndexError):
        signal(values)[1][0]


@pytest.mark.parametrize("ask", ["stays", "settles", "rms"])
def test_what_is_not_a_number_fails(ask: str) -> None:
    wrong = signal(np.array([0.0, np.nan]))
    questions: dict[str, Callable[[], object]] = {
        "stays": lambda: wrong.stays(-np.inf, np.inf),
        "settles": lambda: wrong.settles(0.0, band=1.0, within=1.0),
        "rms": lambda: wrong.rms(at_most=1.0),
    }
    assert "nan" in figure(questions[ask])[0]


def test_a_signal_settles() -> None:
    values = np.exp(-np.arange(1000) / 100.0)
    took = signal(values).settles(0.0, band=0.05, within=0.4)
    assert took == pytest.approx(0.3)  # ln(20) * 100 ms, to the next sample
    told, time = figure(lambda: signal(values).settles(0.0, band=0.05, within=0.2))
    assert told == "s settles to 0. +- 0.05 N in 0.300 s, and not within 0.2 s"
    assert time == pytest.approx(0.3)
    told, _ = figure(lambda: signal(values[:100]).settles(0.0, band=0.05, within=9.0))
    assert told.startswith("s is 0.371577 N at 0.099 s, the end of this part")
    assert signal(values * 0.0).settles(0.0, band=1.0, within=0.0) == 0.0
    both = np.stack([values, values + 1.0], axis=1)
    assert signal(both).settles([0.0, 1.0], band=0.05, within=0.4) == took


def test_the_rms_of_a_signal() -> None:
    values = np.tile([3.0, -4.0], (5, 1))
    assert signal(values).rms(at_most=5.0) == pytest.approx(5.0)
    assert signal(values).norm().rms() == pytest.approx(5.0)
    assert signal(values[:, 0]).rms(about=1.0) == pytest.approx(2.0)
    told, _ = figure(lambda: signal(values).rms(at_most=4.9))
    assert told == "s has an RMS of 5 N, more than 4.9; largest at 0.000 s"


@pytest.mark.parametrize("ask", ["expect", "never", "allow"])
def test_a_misspelt_event_is_refused(ask: str, run: Run) -> None:
    """`never` would be met for ever."""
    with pytest.raises(ToolError, match=r"no event is named drive_lots; did you mean drive_lost\?"):
        getattr(run, ask)("drive_lots")
    run.never("drive_lo?t")
