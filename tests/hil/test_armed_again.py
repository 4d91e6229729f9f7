"""Arming after a stop by a lost drive. Without an upper one the platform comes to lie beside its
cups: the self-test says so, and once someone has put it back the robot is armed. Without a lower
one it lies in them, and one of its cables is slacker than the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.hil.test_supervisor_recovery import Noted, ordered
from tests.supervised import BRIEF, configured
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Replug, Unplug
from tonus.config.schema.robot_faults import CableCut, PutBack
from tonus.runtime.states import Operator, State

pytestmark = pytest.mark.wide


class _Lost(Noted):
    """A drive is pulled in ACTIVE, and comes back in FAULT; the platform as ``put_back`` says."""

    channel, node = "can1", 3
    put_back = False
    mended = returned = False

    def _before_tick(self, playing: Any) -> None:
        super()._before_tick(playing)
        if State.FAULT in self.states and not self.mended:
            self.mended = True
            playing.lab.inject(Replug(channel=self.channel, node=self.node))
        elif self.mended and self.put_back and not self.returned:
            self.returned = self.states[-1] is State.STANDBY
            if self.returned:
                playing.lab.inject(PutBack())


def _played(
    monkeypatch: pytest.MonkeyPatch, *, put_back: bool = False, node: int = 3
) -> tuple[_Lost, list[str]]:
    ordered(monkeypatch, [(State.FAULT, 0.3, Operator.RESET), (State.STANDBY, 0.8, Operator.ARM)])
    config, _ = configured(**BRIEF, **{"supervisor.policy": "off"})

    def pulled() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(Unplug(channel=run.channel, node=run.node))

    run = _Lost(config, load_scenario("hold"), pulled, State.ACTIVE, at=0.3)
    run.put_back, run.node = put_back, node
    seen = run.play(8.5)
    return run, [each.text for each in seen.events if each.name == "refused"]


def test_a_platform_beside_its_cups_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until 2026-11-29 it was armed, and a sound cable was found wrong as the platform slid."""
    run, refused = _played(monkeypatch)
    assert State.REFERENCING not in run.states[run.states.index(State.FAULT) :]
    assert "put it into the cups of its cradle" in refused[-1]


@pytest.mark.parametrize(("put_back", "node"), [(True, 3), (False, 5)])
def test_it_is_armed_again(monkeypatch: pytest.MonkeyPatch, put_back: bool, node: int) -> None:
    """Of the second, cable 4 has 0.1 m of slack. Until 2026-11-29 the tension of the others tilted
    the platform out of its cups meanwhile."""
    run, _ = _played(monkeypatch, put_back=put_back, node=node)
    again = run.states[run.states.index(State.FAULT) :]
    assert again[1:] == [State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD]


def test_a_load_that_was_not_played_waits_for_the_next_arming(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It comes 6 s after arming. Until 2026-11-29 that was the first arming, and the platform was
    pulled out of its cups while it was referenced anew."""
    orders = [
        (State.ACTIVE, 0.3, Operator.ESTOP),
        (State.FAULT, 0.3, Operator.RESET),
        (State.STANDBY, 0.8, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    config, _ = configured(**BRIEF, **{"supervisor.policy": "off"})
    pulled = []

    class Watched(_Lost):
        put_back = True

        def _before_tick(self, playing: Any) -> None:
            self.mended = State.FAULT in self.states  # nothing was unplugged
            super()._before_tick(playing)
            if playing.lab is not None:
                force = float(np.abs(playing.lab.plant.load_wrench).max())
                pulled.append((self.states[-1:], force))

    run = Watched(config, load_scenario("load_test"), lambda: None, State.ACTIVE, at=0.3)
    run.play(10.5)
    assert run.states[-3:] == [State.REFERENCING, State.PRETENSION, State.HOLD]
    loaded = [state for state, force in pulled if force > 1.0]
    assert loaded, "or it was not played at all"
    assert all(state == [State.HOLD] for state in loaded)


def test_a_cable_that_stays_slack_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has torn at rest, after a first run; the others leave the platform where it lies."""
    ordered(monkeypatch, [(State.STANDBY, 0.5, Operator.ARM)])
    config, _ = configured(**BRIEF, **{"supervisor.policy": "off"})
    moved = [0.0]

    def cut() -> None:
        run._playing.lab.inject(CableCut(axis=4))

    class Watched(Noted):
        def _before_tick(self, playing: Any) -> None:
            super()._before_tick(playing)
            if self.states.count(State.REFERENCING) == 2:
                rest = np.array(config.robot.rest)
                moved.append(float(np.linalg.norm(playing.lab.plant.position - rest)))

    run = Watched(config, load_scenario("hold"), cut, State.STANDBY, at=0.2)
    seen = run.play(6.5)
    assert run.states[-3:] == [State.REFERENCING, State.SAFE_STOP, State.FAULT]
    assert [each.where for each in seen.events if each.name == "cable_slack"] == ["can1/5 (axis 4)"]
    (said,) = [each.text for each in seen.events if each.name == "referencing_failed"]
    assert "axis 4" in said
    assert "still slack after 5 s" in said
    assert max(moved) < 0.004, "m; a cup is 10 mm wide"
