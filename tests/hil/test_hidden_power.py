"""Daemons whose drives have power while every answer of theirs says that they have none, or whose
torque acts where none is looked for: by what acts on a SYNC, by SDO, and under a stop that was
never controlled. As in `test_wrong_daemons.py`: in virtual time, on CAN.
"""

from __future__ import annotations

from typing import Any

import can
import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import after, blind, both, opposite, torque_in_control
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.ethercat.master import EthercatFieldbus
from tonus.drivers.exchange import Exchange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import Operator, State, StopMode
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Operated

pytestmark = pytest.mark.wide

TIMEOUT_MS = 17.0
MOST_TENSION = 60.0
"""N until the drives stop: cables that are slack, or at their pretension, when it begins"""


def stopped(run: Run, seen: Observed, requirement: Requirement, longest_ms: float) -> None:
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {requirement}
    assert run.slowest_ms <= longest_ms + TIMEOUT_MS
    until = seen.truth_ns <= max(run.stopped_ns.values())
    assert seen.truth["tension"][until].max() < MOST_TENSION


_BEFORE = -1_000_000
"""the change"""


class Ticks:
    """Counts those since the change, from ``first`` on."""

    def __init__(self, first: int = 0) -> None:
        self.count, self._next = _BEFORE, first

    def commands(self, result: tuple[Any, Any], *_: Any) -> tuple[list[int], list[int]]:
        """Up to power in steps, then what `told` says."""
        del result
        self.count, self._next = self._next, self._next + 1
        word, mille = self.told(self.count)
        return [word] * 8, [mille] * 8

    def told(self, tick: int) -> tuple[int, int]:
        return (0x06, 0) if tick < 4 else (0x07, 0) if tick < 10 else (0x0F, 1000 + tick % 3)


def idle(patch: pytest.MonkeyPatch) -> None:
    """No operator, and no fault."""
    blind(patch)
    patch.setattr(Operated, "next", lambda *_: Operator.NONE)


@pytest.mark.parametrize("apart", [12, 100])
def test_power_between_syncs(monkeypatch: pytest.MonkeyPatch, apart: int) -> None:
    """Two SYNCs one behind the other now and then: power acts on the second, and ends with the
    first of the next two. What is sent between them never acts."""

    class Hidden(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick < 30 or tick % apart != 1:
                return (0x06, 0) if tick < 10 else (0x07, 0)
            return 0x0F, 1000 + tick % 3

    ticks, sync = Hidden(), Channels.sync

    def seldom(self: Channels, tick: int) -> None:
        if ticks.count < 30 or ticks.count % apart in (0, 1):
            sync(self, tick)

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        monkeypatch.setattr(Channels, "sync", seldom)

    idle(monkeypatch)
    run = Run(configured(**BRIEF)[0], load_scenario("hold"), change, state=State.STANDBY, at=0.5)
    stopped(run, run.play(0.5), Requirement.TORQUE, 45.0 + apart)


def test_power_between_frames_on_ethercat(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the record alone, which has another torque, it takes as long as a disarmed robot may have
    power, counted slowly."""

    class Hidden(Ticks):
        def told(self, tick: int) -> tuple[int, int]:
            if tick < 30 or tick % 18 != 3:
                return (0x06, 0) if tick < 10 else (0x07, 0)
            return 0x0F, 1000

    ticks, send = Hidden(), EthercatFieldbus._send

    def seldom(self: EthercatFieldbus, outputs: list[bytes], tick: int | None) -> None:
        if ticks.count < 30 or ticks.count % 18 < 4:
            send(self, outputs, tick)

    def write(record: Any, *_: Any) -> Any:
        acts = ticks.count >= 30 and ticks.count % 18 == 3
        record.drives.torque_command[...] = (1000 if acts else ticks.count % 2) * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)
        monkeypatch.setattr(EthercatFieldbus, "_send", seldom)

    idle(monkeypatch)
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    train = config.robot.drive_trains[0]
    newton_metre = 1e-3 * train.motor.rated_torque * train.gearbox.ratio
    run = RelayRun(config, load_scenario("hold"), change, state=State.STANDBY, at=0.7)
    seen = run.play(0.4)
    assert run.off_ms is not None, seen.error
    assert run.off_ms < 150.0


def test_drives_that_are_enabled_by_sdo_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """In pre-operational, where they send no process data; whoever does it."""

    class Commanded(Run):
        ticks = 0

        def _before_tick(self, playing: Any) -> None:
            super()._before_tick(playing)
            if not self.changed_ns:
                return
            self.ticks += 1
            steps = {5: (0x6040, 0x06), 8: (0x6040, 0x07), 11: (0x6071, 800), 14: (0x6040, 0x0F)}
            for node in DRIVES:
                bus = self._buses[(node - 1) // 2]
                if self.ticks == 1:
                    told = can.Message(arbitration_id=0, data=bytes([0x80, node]))
                elif self.ticks in steps:
                    index, value = steps[self.ticks]
                    data = bytes([0x2B, index & 0xFF, index >> 8, 0, *value.to_bytes(4, "little")])
                    told = can.Message(arbitration_id=0x600 + node, data=data)
                else:
                    continue
                told.is_extended_id = False
                bus.send(told)

    idle(monkeypatch)
    config, _ = configured(**BRIEF)
    run = Commanded(config, load_scenario("hold"), lambda: None, state=State.STANDBY, at=0.5)
    stopped(run, run.play(0.3), Requirement.COMMANDED, 10.0)


def test_a_stop_of_what_was_never_controlled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its bounds are those of forces, and no cell of this one was measured since it stood still."""
    ticks = Ticks(-40)

    def write(record: Any, *_: Any) -> Any:
        if ticks.count >= 0:
            record.state.state[...] = State.SAFE_STOP
            record.state.stop_mode[...] = StopMode.DESCENT
            record.drives.torque_command[...] = ticks.told(ticks.count)[1] * newton_metre
        return record

    def change() -> None:
        after(Exchange, "commands", ticks.commands)(monkeypatch)
        after(ControlCycle, "write", write)(monkeypatch)
        for node in range(17, 26):
            for bus in run._buses:
                told = can.Message(data=bytes([0x80, node]), is_extended_id=False)
                bus.send(told)

    idle(monkeypatch)
    config, _ = configured(**BRIEF)
    train = config.robot.drive_trains[0]
    newton_metre = (
        1e-3 * train.motor.rated_torque * train.gearbox.ratio * np.array(config.robot.signs)
    )
    run = Run(config, load_scenario("hold"), change, state=State.STANDBY, at=0.5)
    seen = run.play(0.3)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.DISARMED}
    assert run.slowest_ms < 150.0


def test_a_torque_that_acts_and_is_not_the_newest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A SYNC in every fifth tick, and before it the wrong torque; right ones after it."""
    ticks, sync = {"now": 0}, Channels.sync

    def seldom(self: Channels, tick: int) -> None:
        ticks["now"] = tick
        if tick % 5 == 0:
            sync(self, tick)

    def wrong(torque: Any) -> Any:
        found: Any = opposite(torque) if ticks["now"] % 5 == 4 else np.array(torque)
        return found

    def change() -> None:
        both(blind, torque_in_control(wrong))(monkeypatch)
        monkeypatch.setattr(Channels, "sync", seldom)

    run = Run(configured(**BRIEF)[0], load_scenario("sine_z"), change)
    stopped(run, run.play(0.4), Requirement.OPPOSED, 25.0)
