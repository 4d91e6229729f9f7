"""After a stop by a lost drive the platform lies beside its cups: the self-test says so, and once
someone has put it back the robot is armed again."""

from __future__ import annotations

from typing import Any

import pytest

from tests.hil.test_supervisor_recovery import Noted, ordered
from tests.supervised import BRIEF, configured
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Replug, Unplug
from tonus.config.schema.robot_faults import PutBack
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


def _played(monkeypatch: pytest.MonkeyPatch, *, put_back: bool) -> tuple[_Lost, list[str]]:
    ordered(monkeypatch, [(State.FAULT, 0.3, Operator.RESET), (State.STANDBY, 0.8, Operator.ARM)])
    config, _ = configured(**BRIEF, **{"supervisor.policy": "off"})

    def pulled() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(Unplug(channel=run.channel, node=run.node))

    run = _Lost(config, load_scenario("hold"), pulled, State.ACTIVE, at=0.3)
    run.put_back = put_back
    seen = run.play(7.5)
    return run, [each.text for each in seen.events if each.name == "refused"]


def test_a_platform_beside_its_cups_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until 2026-11-29 it was armed, and a sound cable was found wrong as the platform slid."""
    run, refused = _played(monkeypatch, put_back=False)
    assert State.REFERENCING not in run.states[run.states.index(State.FAULT) :]
    assert "put it into the cups of its cradle" in refused[-1]


def test_a_platform_that_was_put_back_is_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    run, _ = _played(monkeypatch, put_back=True)
    again = run.states[run.states.index(State.FAULT) :]
    assert again[1:] == [State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD]
