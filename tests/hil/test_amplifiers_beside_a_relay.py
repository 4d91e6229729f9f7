"""Load cells on CAN beside drives on EtherCAT: what others write to their amplifiers stops the
robot as on CAN alone, and the reset brings them up anew."""

from __future__ import annotations

import struct
from typing import Any

import can
import pytest

from tests.hil.test_supervisor_recovery import ordered
from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, configured
from tonus.config import load
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Loss
from tonus.config.schema.root import Config
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock

_CHANNEL, _CONTACT = "can0", 25
"""of config/mixed.yaml"""
_SCALE = 0x6123


pytestmark = pytest.mark.wide


class _Written(RelayRun):
    """Another master writes the scale of the contact cell once, after an emergency stop."""

    loses = False
    """it writes in ACTIVE, and the supervisor's next emergency frame is lost"""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.states: list[State] = []
        self.scales: list[bytes] = []
        """each that the amplifier has had"""

    def _before_tick(self, playing: Any) -> None:
        super()._before_tick(playing)
        last, lab = playing._cycles.last, playing.lab
        if last is None or lab is None:
            return
        state = last["state"]
        if [int(state["state"])] != self.states[-1:]:
            self.states.append(State(int(state["state"])))
        scale = lab.nodes[_CHANNEL, _CONTACT].device.objects.read(_SCALE, 1)
        if self.scales[-1:] != [scale]:
            self.scales.append(scale)
        within = State.ACTIVE if self.loses else State.STANDBY
        waited = state["state"] == within and state["elapsed"] >= 0.3
        if (State.FAULT in self.states or self.loses) and not self.changed_ns and waited:
            self.changed_ns = clock.now_ns()
            if self.loses:
                lab.inject(Loss(channel=self._channels()[0], identifier=0x0FE, frames=1))
            data = struct.pack("<BHBI", 0x23, _SCALE, 1, 0x43160000)
            request = 0x600 + _CONTACT
            self._buses.append(can.Bus(interface="tonus", channel=_CHANNEL))
            self._buses[-1].send(
                can.Message(arbitration_id=request, data=data, is_extended_id=False)
            )


def _configuration() -> Config:
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    own = relay.model_dump(mode="json") | {"timeout_ms": 7}
    stated = {"sto_relay": own, "supervisor.policy": "require"}
    return configured("config/mixed.yaml", **BRIEF, **stated)[0]


def test_another_master_writes_to_the_contact_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a scale that is wrong a contact of 40 N would be taken for one of 20."""
    orders = [
        (State.ACTIVE, 0.1, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.4, Operator.ARM),
        (State.STANDBY, 0.8, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    run = _Written(_configuration(), load_scenario("hold"), at=60.0)
    run.play(3.0)
    after = run.states[run.states.index(State.FAULT) :]
    assert after[1:5] == [State.STANDBY, State.FAULT, State.STANDBY, State.REFERENCING]
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    assert len(run.scales) == 3
    assert run.scales[-1] == run.scales[0]


def test_the_one_frame_that_tells_of_it_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """The operator presses emergency stop 20 ms later. After the reset the daemon is told once
    more, and the next reset brings the amplifiers up."""
    orders = [
        (State.ACTIVE, 0.32, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    run = _Written(_configuration(), load_scenario("hold"), at=60.0)
    run.loses = True
    run.play(4.0)
    after = run.states[run.states.index(State.FAULT) :]
    assert after[1:5] == [State.STANDBY, State.FAULT, State.STANDBY, State.REFERENCING]
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    assert len(run.scales) == 3
    assert run.scales[-1] == run.scales[0]
