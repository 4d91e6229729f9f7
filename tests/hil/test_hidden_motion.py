"""Daemons that move the platform while the drums hardly show it: it swings on its cables, or slack
cables are reeled in with the others. As in `test_wrong_daemons.py`, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import UPPER, Change, after, blind, both
from tonus.config import Config
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.process_image import AxisCommand
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.tools.campaign.observed import Observed

pytestmark = pytest.mark.wide

DRUM, FRICTION = 10.5, 2.5
"""kg and N, of a drum at its cable"""
SETTLING_S = 0.8
SLACKENING_S = 1.6
Law = Callable[["Hidden", float], Any]
"""N of each drive, by what is known and the s since the change"""


class Hidden:
    """Torques by a law, and a record that fits: what was sent and measured, with references that
    explain the torques."""

    def __init__(
        self, config: Config, law: Law, state: State, mode: StopMode = StopMode.NONE
    ) -> None:
        self.radius = np.array([train.drum.radius for train in config.robot.drive_trains])
        self.tension = self.rate = np.zeros(len(DRIVES))
        self.length: Any = None
        """m that each drum has reeled in since the change"""
        self._law, self._state, self._mode = law, state, mode
        self._begin = self._angle = None
        self._ticks = 0

    def change(self) -> Change:
        acted = after(ControlCycle, "act", self._acted)
        return both(blind, acted, after(ControlCycle, "write", self._written))

    def _acted(self, _: None, cycle: ControlCycle, image: Any, *rest: Any) -> None:
        del rest
        angle = image.axes["angle"].copy()
        if self._angle is None:
            self._begin = self._angle = angle
        moved = (angle - self._angle) * self.radius / 1e-3
        self.rate = self.rate + 0.4 * (moved - self.rate)
        self._angle, self.length = angle, (angle - self._begin) * self.radius
        self.tension = np.nan_to_num(cycle._sensing.tension.copy())
        newton = np.clip(self._law(self, self._ticks * 1e-3), -300.0, 515.0)
        newton += 0.2 * ((np.arange(len(newton)) + self._ticks) % 5)  # not frozen
        self._ticks += 1
        pull = newton - self.tension
        low = np.clip(self.tension - 22.0, 0.0, 219.0)
        high = np.clip(np.maximum(self.tension + 22.0, newton - 290.0), 18.6, 219.0)
        self._reference = np.where(pull > 0.0, high, low)
        image.command.fill(int(AxisCommand.ENABLE))
        image.commands["torque"] = newton * self.radius

    def _written(self, record: Any, *_: Any) -> Any:
        record.state.state[...], record.state.stop_mode[...] = self._state, self._mode
        record.state.fault[...] = record.state.operator[...] = 0
        record.state.failed[...] = False
        record.stiffness.k_eq[...] = 3210.0
        record.tension.reference[...] = self._reference
        record.tension.measured[...] = record.force_cells.raw[:8] - record.force_cells.tare[:8]
        return record


def swung(config: Config, direction: int, amplitude: float, hertz: float, newton: float) -> Law:
    """All drums follow a motion of the platform, m/s or rad/s, at the frequency at which it swings
    on its cables, around a higher tension."""
    geometry = config.robot.geometry
    platform = np.array(geometry.platform)
    along = np.array(geometry.frame) - platform
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    row = np.hstack([along, np.cross(platform, along)])[:, direction]
    first: list[Any] = []

    def law(hidden: Hidden, elapsed_s: float) -> Any:
        first.append(hidden.tension.copy()) if not first else None
        rise = min(elapsed_s / SETTLING_S, 1.0)
        base = (first[0] + rise * (newton - 45.0) - first[0]) / 3000.0
        swinging_s = max(elapsed_s - SETTLING_S, 0.0)
        most, phase = amplitude * min(swinging_s / 0.3, 1.0), 2.0 * np.pi * hertz * swinging_s
        turning = 2.0 * np.pi * hertz
        speed, place = most * np.sin(phase) * row, -most / turning * np.cos(phase) * row
        return (
            hidden.tension
            + DRUM * most * turning * np.cos(phase) * row
            + 700.0 * (speed - hidden.rate)
            + 700.0 * 15.0 * (base + place - hidden.length)
            + 3.0 * np.sign(speed)
        )

    return law


def thrown(hidden: Hidden, elapsed_s: float) -> Any:
    """The lower cables are paid out slowly until they are slack; then all drums reel in together,
    and out."""
    if elapsed_s < SLACKENING_S:
        found = _at_speed(hidden, np.where(UPPER, 0.0, -0.2), 1050.0)
        found[:4] = 7.0
        return found
    since_s = (elapsed_s - SLACKENING_S) % 0.3
    speed = 0.75 if since_s < 0.13 else -0.75 if since_s < 0.26 else 0.0
    return _at_speed(hidden, np.full(len(DRIVES), speed), 3000.0)


def _at_speed(hidden: Hidden, speed: Any, gain: float) -> Any:
    pull = np.sign(speed) * FRICTION + gain * (speed - hidden.rate)
    return np.maximum(hidden.tension, 0.0) + pull


def stopped(seen: Observed, run: Any, since_s: float, end_ns: float) -> tuple[float, float, float]:
    """ms from then to ``end_ns``, and the largest speed and turning rate until then."""
    begin_ns = run.changed_ns + since_s * 1e9
    until = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= end_ns)
    speed = np.linalg.norm(seen.truth["velocity"][until], axis=1)
    turning = np.linalg.norm(seen.truth["angular_velocity"][until], axis=1)
    return (end_ns - begin_ns) * 1e-6, float(speed.max()), float(turning.max())


@pytest.mark.parametrize(
    ("state", "mode", "motion", "within_ms", "speed", "turning"),
    [
        (State.ACTIVE, StopMode.NONE, (2, 0.29, 10.2, 110.0), 280.0, 0.45, 0.5),
        (State.ACTIVE, StopMode.NONE, (0, 0.29, 10.2, 110.0), 330.0, 0.45, 1.5),
        (State.PRETENSION, StopMode.NONE, (2, 0.29, 10.2, 110.0), 280.0, 0.45, 0.5),
        (State.SAFE_STOP, StopMode.ON_PATH, (2, 0.45, 10.2, 120.0), 330.0, 1.15, 0.5),
        (State.ACTIVE, StopMode.NONE, (5, 1.4, 14.0, 90.0), 330.0, 0.2, 2.5),
    ],
    ids=["z", "x", "pretension", "along the path", "turning"],
)
def test_a_platform_that_swings_on_its_cables(
    monkeypatch: pytest.MonkeyPatch,
    state: State,
    mode: StopMode,
    motion: tuple[int, float, float, float],
    within_ms: float,
    speed: float,
    turning: float,
) -> None:
    """The drums move by a seventh of it. Until 2026-11-29 it went on to the end: 1.7 m/s, along the
    path 2.9, and 8.1 rad/s."""
    config, _ = configured(**BRIEF)
    hidden = Hidden(config, swung(config, *motion), state, mode)
    begins = State.ACTIVE if mode else state
    change = hidden.change()
    run = Run(
        config,
        load_scenario("hold"),
        lambda: change(monkeypatch),
        state=begins,
        at=0.3 if begins is State.ACTIVE else 0.9,
    )
    seen = run.play(1.6)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.SPEED}
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    found = stopped(seen, run, SETTLING_S, max(run.stopped_ns.values()))
    assert found <= (within_ms, np.inf, np.inf)
    assert found[1] <= speed
    assert found[2] <= turning


@pytest.mark.parametrize(
    ("state", "mode", "amplitude", "newton", "speed"),
    [
        (State.ACTIVE, StopMode.NONE, 0.29, 110.0, 0.7),
        (State.SAFE_STOP, StopMode.ON_PATH, 0.45, 120.0, 1.7),
    ],
)
def test_a_platform_that_swings_while_looks_are_late(
    monkeypatch: pytest.MonkeyPatch,
    state: State,
    mode: StopMode,
    amplitude: float,
    newton: float,
    speed: float,
) -> None:
    """By as much as SUP-24 lets pass, on a host that is busy. Until 2026-11-30 it went on to the
    end, as `test_a_platform_that_swings_on_its_cables` did before."""
    config, _ = configured(**BRIEF)
    change = Hidden(config, swung(config, 2, amplitude, 10.2, newton), state, mode).change()
    looks, step = count(1), Supervisor.step

    def late(self: Supervisor, now_ns: int) -> None:
        if next(looks) % 4 == 0:
            step(self, now_ns)

    def change_both() -> None:
        monkeypatch.setattr(Supervisor, "step", late)
        change(monkeypatch)

    run = Run(config, load_scenario("hold"), change_both, state=State.ACTIVE, at=0.3)
    seen = run.play(1.6)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.SPEED}
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    found = stopped(seen, run, SETTLING_S, max(run.stopped_ns.values()))
    assert found[0] <= 330.0
    assert found[1] <= speed


def pumped(hidden: Hidden, elapsed_s: float) -> Any:
    """Each drum is reeled in with more than it is paid out with."""
    del elapsed_s
    middle = (12.0 + 4.2) / 2.0
    return np.where(hidden.rate > 0.0, 17.0, np.where(hidden.rate < 0.0, -4.2, middle)) - 0.4


def test_a_passive_stop_that_does_not_damp(monkeypatch: pytest.MonkeyPatch) -> None:
    """The platform falls from 0.18 m. Until 2026-11-30 it was pumped to 0.92 m/s, and nothing was
    found before it lay in its cradle."""
    high = {"robot.home": [0.0, 0.0, 0.18], "control.sequence.lift_s": 3.5}
    config, _ = configured(**BRIEF | high)
    change = Hidden(config, pumped, State.SAFE_STOP, StopMode.PASSIVE).change()
    run = Run(
        config, load_scenario("hold"), lambda: change(monkeypatch), state=State.ACTIVE, at=0.3
    )
    seen = run.play(0.7)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.BRAKED}
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert stopped(seen, run, 0.0, max(run.stopped_ns.values()))[0] <= 60.0
    assert stopped(seen, run, 0.0, float(seen.truth_ns[-1]))[1] <= 0.65  # on the drives' brakes


@pytest.mark.parametrize("state", [State.PRETENSION, State.REFERENCING])
def test_slack_cables_that_are_reeled_in_with_the_others(
    monkeypatch: pytest.MonkeyPatch, state: State
) -> None:
    """By all drums the platform stands. Until 2026-11-29: 4.1 m/s for 1.3 s, and 3.1 m/s to the
    end."""
    config, _ = configured(**BRIEF)
    hidden = Hidden(config, thrown, state)
    change = hidden.change()
    at = 0.05 if state is State.PRETENSION else 0.3
    run = Run(config, load_scenario("hold"), lambda: change(monkeypatch), state=state, at=at)
    seen = run.play(2.2)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.SPEED}
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    late_ms, speed, _ = stopped(seen, run, SLACKENING_S, max(run.stopped_ns.values()))
    assert late_ms <= 45.0
    assert speed <= 0.6


def test_a_platform_that_swings_on_its_cables_on_ethercat(monkeypatch: pytest.MonkeyPatch) -> None:
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    hidden = Hidden(config, swung(config, 2, 0.29, 10.2, 110.0), State.ACTIVE)
    change = hidden.change()
    run = RelayRun(config, load_scenario("hold"), lambda: change(monkeypatch), at=0.3)
    seen = run.play(1.6)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.SPEED}
    late_ms, speed, _ = stopped(seen, run, SETTLING_S, run.changed_ns + run.open_ms * 1e6)
    assert late_ms <= 310.0
    assert speed <= 0.7
