"""A torque without bounds meets bounds in the drive: current, speed and the motor's heat, which the
daemon wrote at bring-up and read back. The daemon is changed in mid-run and finds no fault, and no
supervisor stops it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.loop import QUICK
from tests.supervised import Run, configured
from tonus.config.schema.robot_faults import CableCut
from tonus.drivers.exchange import Exchange
from tonus.runtime.safety.faults import Faults
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Playing

pytestmark = pytest.mark.wide

AXIS = 5
WILD = 32767
"""per mille of the rated torque, all that 0x6071 holds"""


def played(
    monkeypatch: pytest.MonkeyPatch, seconds: float, *, torn: bool, **overrides: Any
) -> Observed:
    """The axis gets all torque there is from an instant on, its cable ``torn`` or not."""
    config, scenario = configured(**QUICK, **overrides)
    original = Exchange.commands

    def wild(exchange: Exchange, *given: Any) -> Any:
        words, torques = original(exchange, *given)
        torques = torques.copy()
        torques[AXIS] = WILD
        return words, torques

    run: Run

    def change() -> None:
        monkeypatch.setattr(Exchange, "commands", wild)
        monkeypatch.setattr(Faults, "add", lambda *_: False)
        if torn:
            playing: Playing = run._playing
            playing.lab.inject(CableCut(axis=AXIS))

    run = Run(config, scenario, change)
    with monkeypatch.context():
        return run.play(seconds)


def test_the_drum_of_a_torn_cable_is_no_faster_than_the_drive_admits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = played(monkeypatch, 0.3, torn=True)
    radius = seen.config.robot.drum.radius
    admitted = seen.config.robot.motor.maximum_speed_rpm
    assert admitted is not None
    bound = admitted * 2.0 * np.pi / 60.0 / seen.config.robot.gearbox.ratio
    fastest = seen.truth["drum_rate"][:, AXIS].max()
    assert 0.85 * bound < fastest < 1.02 * bound
    assert 0.75 < fastest * radius < 0.91


def test_without_that_bound_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the test above can fail."""
    free = {"robot.motor.maximum_speed_rpm": 50000}
    seen = played(monkeypatch, 0.3, torn=True, **free)
    assert seen.truth["drum_rate"][:, AXIS].max() * seen.config.robot.drum.radius > 3.0


def test_the_current_is_no_larger_than_the_limit_and_falls_to_nominal_when_it_is_hot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = played(monkeypatch, 2.5, torn=False)
    motor = seen.config.robot.motor
    current = seen.truth["current"][:, AXIS]
    assert current.max() == pytest.approx(motor.current_limit, rel=0.01)
    # I2t: after tau ln(4/3) at twice the nominal current, less what it was warm before.
    assert current[-200:].max() == pytest.approx(motor.nominal_current, rel=0.01)
