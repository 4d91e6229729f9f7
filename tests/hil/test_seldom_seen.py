"""Daemons whose wrong torques the supervisor sees in few of its looks: they act from SYNC to SYNC,
in every second tick, or between answers that come seldom; and drives that are off and told to be
on. As in `test_wrong_daemons.py`, in virtual time, on CAN and on EtherCAT."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import (
    UPPER,
    Change,
    Wrong,
    after,
    anew,
    blind,
    both,
    raises,
    stopped_in_time,
    torque_on_the_bus,
)
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.ethercat.inputs import Inputs
from tonus.drivers.exchange import Exchange
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import State
from tonus.tools.campaign.observed import Observed

pytestmark = pytest.mark.wide

OUTPUT_MS = 25.0
"""to the relay's output, from when a torque is wrong where each answer shows it"""


def played(wrong: Wrong, change: Change, patch: pytest.MonkeyPatch, seconds: float = 0.4) -> None:
    """With the torques' references in the record."""

    def recorded(record: Any, *_: Any) -> Any:
        record.tension.reference[...] = np.where(UPPER, *wrong.references)
        return record

    def made() -> None:
        references = () if wrong.passive else (after(ControlCycle, "write", recorded),)
        both(blind, change, *references)(patch)

    stop = wrong.state is State.SAFE_STOP
    scenario = load_scenario("hold" if stop else "sine_z")
    run = Run(configured(**BRIEF)[0], scenario, made, wrong.state, at=0.1 if stop else 0.5)
    with patch.context():
        seen = run.play(seconds)
    patch.undo()
    stopped_in_time(wrong, run, seen)


class Pulled:
    """Torques at the cables, never equal to the last bit, in the ticks that ``acts`` names."""

    def __init__(
        self, wrong: Wrong, acts: Callable[[int], bool], axes: Sequence[int] = range(8)
    ) -> None:
        robot = configured(**BRIEF)[0].robot
        self._radius = np.array([train.drum.radius for train in robot.drive_trains])
        self._newton = np.where(UPPER, *wrong.torques)
        self._acts, self._axes, self._count = acts, list(axes), 0

    def right(self, torque: Any) -> Any:
        """What is sent in the other ticks."""
        return torque

    def __call__(self, _: None, cycle: ControlCycle, image: Any, tick: int, *__: Any) -> None:
        del cycle
        torque = self.right(image.commands["torque"].copy())
        if self._acts(tick):
            self._count += 1
            newton = self._newton + 0.3 * (self._count % 5)
            torque[self._axes] = (newton * self._radius)[self._axes]
        image.commands["torque"] = torque


def between_syncs(wrong: Wrong) -> Change:
    """A SYNC in each 16th tick on two channels, and the wrong torque in the tick before it."""
    axes, places, apart = (1, 3, 5, 7), (2, 3), 16
    fill, now = Exchange.fill, [0]

    def seldom(self: Channels, tick: int) -> None:
        now[0] = tick
        for place, channel in enumerate(self._channels):
            if place not in places or tick % apart == 0:
                channel.sync(tick)

    def patient(self: Exchange, tick: int) -> None:
        self._freshness = 50
        fill(self, tick)

    def made(patch: pytest.MonkeyPatch) -> None:
        pulled = Pulled(wrong, lambda _: (now[0] + 1) % apart == 0, axes)
        patch.setattr(Exchange, "fill", patient)
        patch.setattr(Channels, "sync", seldom)
        after(ControlCycle, "fall_back" if wrong.passive else "act", pulled)(patch)
        if wrong.passive:
            patch.setattr(ControlCycle, "act", raises)

    return made


BETWEEN_SYNCS = {
    "in a passive stop": Wrong(
        *(State.ACTIVE, (690.0, -690.0), (0.0, 0.0)),
        *(Requirement.BRAKED, 40.0, 0.4, 100.0),
        passive=True,
    ),
    "all upwards in a passive stop": Wrong(
        *(State.ACTIVE, (200.0, 200.0), (0.0, 0.0), Requirement.BRAKED, 40.0, 0.1, 100.0),
        passive=True,
    ),
    "in control": Wrong(
        State.ACTIVE, (690.0, 690.0), (219.0, 219.0), Requirement.OPPOSED, 45.0, 0.4, 130.0
    ),
}


@pytest.mark.parametrize("name", BETWEEN_SYNCS)
def test_a_torque_that_acts_from_one_sync_to_the_next(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Right ones are sent in every other tick. Until 2026-11-28 those alone were judged: 245 N to
    the end of the passive stop, 1.3 m/s after 269 ms, 307 N after 109 ms."""
    wrong = BETWEEN_SYNCS[name]
    played(wrong, between_syncs(wrong), monkeypatch)


class Alternating(Pulled):
    def right(self, torque: Any) -> Any:
        return torque * 0.0 + 0.02 * (self._count % 5)


IN_EVERY_SECOND_TICK = {
    "of all cables in a stop": Wrong(
        State.SAFE_STOP, (690.0, 690.0), (5.0, 5.0), Requirement.OPPOSED, 30.0, 0.2, 100.0
    ),
    "of the upper ones in a stop": Wrong(
        State.SAFE_STOP, (690.0, -270.0), (5.0, 5.0), Requirement.OPPOSED, 30.0, 0.4, 100.0
    ),
    "of the upper ones in control": Wrong(
        State.ACTIVE, (690.0, -270.0), (18.6, 18.6), Requirement.OPPOSED, 30.0, 0.4, 100.0
    ),
}


@pytest.mark.parametrize("parity", [0, 1])
@pytest.mark.parametrize("name", IN_EVERY_SECOND_TICK)
def test_a_torque_against_its_reference_in_every_second_tick(
    name: str, parity: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And hardly any in the others, one of which is the newest in each look. Until 2026-11-28 it
    took 58 to 136 ms: 1.6 m/s, 355 N."""
    wrong = IN_EVERY_SECOND_TICK[name]
    pulled = Alternating(wrong, lambda tick: tick % 2 == parity)
    played(wrong, after(ControlCycle, "act", pulled), monkeypatch)


def switched_off_once(*axes: int) -> Change:
    """They are told to disable voltage in one tick, and to enable operation in all later ones,
    which does nothing in Switch On Disabled; control has no torque for them."""

    def made() -> Change:
        count = [0]

        def told(result: tuple[Any, Any], *_: Any) -> tuple[Any, Any]:
            words = list(result[0])
            count[0] += 1
            for axis in axes:
                words[axis] = 0x00 if count[0] == 1 else 0x0F
            return words, result[1]

        def none(_: None, cycle: ControlCycle, image: Any, *__: Any) -> None:
            del cycle
            image.commands["torque"][list(axes)] = 0.0

        return both(after(Exchange, "commands", told), after(ControlCycle, "act", none))

    return anew(made)


@pytest.mark.parametrize("axes", [(2,), (4, 5, 6, 7)], ids=str)
@pytest.mark.parametrize("state", [State.PRETENSION, State.ACTIVE])
def test_drives_that_are_off_and_told_to_be_on(
    state: State, axes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until 2026-11-28 their commands counted for what they answer: not found in 0.6 s in
    PRETENSION."""
    change = both(blind, switched_off_once(*axes))
    scenario = load_scenario("sine_z")
    run = Run(configured(**BRIEF)[0], scenario, lambda: change(monkeypatch), state, at=0.3)
    with monkeypatch.context():
        seen = run.play(0.4)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.DISARMED}
    assert len(run.stopped_ns) >= len(DRIVES) - len(axes), seen.error
    assert (max(run.stopped_ns.values()) - run.changed_ns) * 1e-6 <= 45.0
    until = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= max(run.stopped_ns.values()))
    assert np.linalg.norm(seen.truth["velocity"][until], axis=1).max() <= 0.3


def seldom_answered(apart: int) -> Change:
    """Whatever comes back is taken in each ``apart``-th tick alone."""
    take, fill = Inputs.take, Exchange.fill

    def made() -> Change:
        count = [-1]

        def seldom(self: Inputs, *rest: Any) -> None:
            count[0] += 1
            if count[0] % apart == 0:
                take(self, *rest)

        def patient(self: Exchange, tick: int) -> None:
            self._freshness = 50
            fill(self, tick)

        def both_of_them(patch: pytest.MonkeyPatch) -> None:
            patch.setattr(Inputs, "take", seldom)
            patch.setattr(Exchange, "fill", patient)

        return both_of_them

    return anew(made)


def on_ethercat(
    change: Change, state: State, patch: pytest.MonkeyPatch, seconds: float = 0.3
) -> tuple[RelayRun, Observed]:
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    made = both(blind, change)
    at = 0.1 if state is State.SAFE_STOP else 0.2
    run = RelayRun(config, load_scenario("hold"), lambda: made(patch), state, at=at)
    with patch.context():
        seen = run.play(seconds)
    patch.undo()
    return run, seen


@pytest.mark.parametrize("apart", [10, 16])
@pytest.mark.parametrize(
    ("state", "passive", "tension"),
    [(State.ACTIVE, True, 200.0), (State.SAFE_STOP, False, 250.0), (State.ACTIVE, False, 250.0)],
    ids=["passive", "on path", "active"],
)
def test_a_torque_on_the_bus_of_drives_whose_answers_are_seldom_taken(
    state: State, passive: bool, tension: float, apart: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The upper cables get 330 N, by the drives' own answers. Until 2026-11-28 each answer was
    forgotten before the next one: in a passive stop it was not found in 0.8 s (0.94 m/s with 200
    N)."""
    config, _ = configured(PATH, **BRIEF)
    train, signs = config.robot.drive_trains[0], np.array(config.robot.signs)
    newton = 1e-3 * train.motor.rated_torque * train.gearbox.ratio / train.drum.radius

    def wrong(torques: Any) -> Any:
        torques = np.array(torques)
        torques[UPPER] = (np.rint(330.0 / newton) * signs)[UPPER]
        return torques

    change = both(seldom_answered(apart), torque_on_the_bus(wrong))
    if passive:
        change = both(change, lambda patch: patch.setattr(Allocation, "distribute", raises))
    run, seen = on_ethercat(change, state, monkeypatch)
    assert {number for number, _ in run.said} <= {Requirement.COMMAND_LOGGED, Requirement.OPPOSED}
    assert run.off_ms <= OUTPUT_MS + apart, seen.error
    until = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= max(run.stopped_ns.values()))
    assert seen.truth["tension"][until].max() <= tension


@pytest.mark.parametrize("apart", [4, 16])
def test_answers_that_are_seldom_taken_stop_nothing_by_themselves(
    apart: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = on_ethercat(seldom_answered(apart), State.ACTIVE, monkeypatch, 0.4)
    assert not run.said
