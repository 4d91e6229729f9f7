"""Drives that pull by themselves: beyond what they are sent, in silence once the robot is disarmed,
or between answers that come seldom. As in `test_wrong_daemons.py`, in virtual time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import UPPER, Change, after, blind, both, raises
from tonus.config import Config
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.exchange import Exchange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock
from tonus.sim.devices.cia402.output import Output
from tonus.tools.campaign.observed import Observed
from tonus.tools.run.supervision import Overheard

pytestmark = pytest.mark.wide

ENABLED, OFF = 0x237, 0x240
"""statuswords"""


def per_mille(config: Config, newton: float) -> int:
    """Of the rated torque, for a tension of so many N."""
    train = config.robot.drive_trains[0]
    return round(
        newton * train.drum.radius / (1e-3 * train.motor.rated_torque * train.gearbox.ratio)
    )


def reached(run: Run, seen: Observed, until_ns: float) -> tuple[float, float]:
    """The largest speed in m/s and tension in N from the change on."""
    since = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= until_ns)
    speed = np.linalg.norm(seen.truth["velocity"][since], axis=1)
    return float(speed.max()), float(seen.truth["tension"][since].max())


@pytest.mark.parametrize("newton", [690.0, 250.0])
@pytest.mark.parametrize("passive", [False, True])
def test_a_drive_that_pulls_by_itself(
    monkeypatch: pytest.MonkeyPatch, newton: float, passive: bool
) -> None:
    """Beyond what it is sent, without a frame. A daemon in order gives its cable up and sends it no
    torque, which is none of what it pulls. Until 2026-11-29 a stop was judged by the wide bounds
    alone: 690 N were found after 626 ms, with 345 N and 0.81 m/s, 250 N not in 2 s."""
    config, _ = configured(**BRIEF)
    outputs: list[Output] = []
    made = Output.__init__

    def kept(self: Output, *given: Any, **named: Any) -> None:
        made(self, *given, **named)
        outputs.append(self)

    monkeypatch.setattr(Output, "__init__", kept)

    def change() -> None:
        if passive:
            monkeypatch.setattr(ControlCycle, "act", raises)
        outputs[2].set_offset(config.robot.signs[2] * per_mille(config, newton))

    run = Run(config, load_scenario("sine_z"), change, at=0.5)
    seen = run.play(0.4)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.UNEXPLAINED}
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms <= 70.0
    speed, tension = reached(run, seen, max(run.stopped_ns.values()))
    assert speed <= 0.6
    assert tension <= 90.0


@pytest.mark.parametrize("axes", [(0,), (0, 1, 2, 3)])
def test_drives_that_keep_their_torque_in_silence(
    monkeypatch: pytest.MonkeyPatch, axes: tuple[int, ...]
) -> None:
    """On EtherCAT, after an emergency stop: the record says that they are silent, and the others
    off. Until 2026-11-29 they counted as pulled, and the relay was held: 701 N, 2.4 m/s of four,
    1.05 m/s of one, to the end."""
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    signs, mille = config.robot.signs, per_mille(config, 690.0)
    silent = np.isin(np.arange(8), axes)

    def commanded(result: tuple[Any, Any], *_: Any) -> tuple[list[int], list[int]]:
        if not run.changed_ns:
            return result
        words = [0x0F if each else 0x00 for each in silent]
        return words, [
            mille * sign if each else 0 for sign, each in zip(signs, silent, strict=True)
        ]

    def recorded(self: Overheard, payload: Any, stamp_ns: int) -> None:
        payload = payload.copy()
        if run.changed_ns:
            payload["state"]["state"], payload["state"]["operator"] = State.FAULT, Operator.NONE
            drives = payload["drives"]
            drives["torque_command"] = drives["torque"] = 0.0
            drives["statusword"] = np.where(silent, ENABLED, OFF)
            age = 1 + (clock.now_ns() - run.changed_ns) // 1_000_000
            drives["age"] = np.where(silent, age, 1)
        publish(self, payload, stamp_ns)

    publish = Overheard.publish
    blind(monkeypatch)
    after(Exchange, "commands", commanded)(monkeypatch)
    monkeypatch.setattr(Overheard, "publish", recorded)
    run = RelayRun(config, load_scenario("hold"), lambda: None, at=0.5)
    seen = run.play(0.2)
    monkeypatch.undo()
    assert not run.said, "nothing that was armed is stopped"
    assert run.off_ms <= 25.0, seen.error
    assert reached(run, seen, run.open_ns)[1] <= 160.0


def seldom(config: Config, apart: int) -> Change:
    """A passive stop. Two channels have a SYNC in each ``apart``-th tick, and their upper drums get
    690 N for the next one whenever they have paid out."""
    radius = np.array([train.drum.radius for train in config.robot.drive_trains])
    behind, pulling = np.isin(np.arange(8), [1, 3, 5, 7]), [1, 3]
    fill, now, count = Exchange.fill, [0], [0]
    lengths, torque = np.zeros(8), np.zeros(8)
    pulled = np.zeros(8, bool)

    def sync(self: Channels, tick: int) -> None:
        now[0] = tick
        for place, channel in enumerate(self._channels):
            if place < 2 or tick % apart == 0:
                channel.sync(tick)

    def patient(self: Exchange, tick: int) -> None:
        self._freshness = 50
        fill(self, tick)

    def pulls(_: None, cycle: ControlCycle, image: Any, *__: Any) -> None:
        del cycle
        count[0] += 1
        length = image.axes["angle"] * radius
        moved = length - lengths
        if (now[0] + 1) % apart == 0:
            paid = (moved < -0.03e-3 * apart) & ~pulled
            pulled[:] = paid & np.isin(np.arange(8), pulling)
            torque[:] = np.where(pulled, 690.0, np.where(UPPER, 15.0, 0.0)) * radius
            torque[:] += 0.4 * radius * (count[0] // apart % 3)
            lengths[:] = length
        beside = (np.where(UPPER, 15.0, 0.0) + 0.02 * (count[0] % 5)) * radius
        image.commands["torque"] = np.where(behind, torque, beside)

    def changed(patch: pytest.MonkeyPatch) -> None:
        patch.setattr(Exchange, "fill", patient)
        patch.setattr(Channels, "sync", sync)
        patch.setattr(ControlCycle, "act", raises)

    return both(blind, after(ControlCycle, "fall_back", pulls), changed)


@pytest.mark.parametrize("apart", [17, 12])
def test_torques_that_know_which_way_a_drum_turns(
    monkeypatch: pytest.MonkeyPatch, apart: int
) -> None:
    """And whose drives answer so seldom that the supervisor does not. Until 2026-11-29 a drum that
    was silent counted as at rest, which no torque drives: 1.7 m/s, not found in 4 s."""
    config, _ = configured(**BRIEF)
    change = seldom(config, apart)
    run = Run(config, load_scenario("sine_z"), lambda: change(monkeypatch), at=0.5)
    with monkeypatch.context():
        seen = run.play(0.3)
    monkeypatch.undo()
    assert {number for number, _ in run.said} == {Requirement.BRAKED}, seen.error
    assert sorted(run.stopped_ns) == list(DRIVES)
    assert reached(run, seen, max(run.stopped_ns.values()))[0] <= 0.5
