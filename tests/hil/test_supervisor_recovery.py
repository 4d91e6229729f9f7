"""The supervisor lets a robot in order begin again: after a stop, and after a fault of a drive."""

from __future__ import annotations

import struct
from collections.abc import Sequence as Listed
from typing import Any

import can
import pytest

from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wired import CHANNEL
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.node import Node
from tonus.runtime.states import Fault, Operator, State, StopMode
from tonus.runtime.timing import clock
from tonus.tools.campaign.again import first_difference
from tonus.tools.campaign.play import Operated
from tonus.tools.run.supervision import Overheard

ROBOT = {**BRIEF, "supervisor.timeout_ms": 22}
FOLLOWING_ERROR = 0x8611
"""of an EPOS4: a fault reset clears it"""
_AMPLIFIER, _SCALE = 25, 0x6123
_RAMP = 0x6085
"""rpm/s, by which a drive brakes that has lost the heartbeat"""
Order = tuple[State, float, Operator]
"""in which state, after how many s, what"""


class Noted(Run):
    """Keeps the states that it has been through."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.states: list[State] = []

    def _before_tick(self, playing: Any) -> None:
        super()._before_tick(playing)
        last = playing._cycles.last
        if last is not None and [int(last["state"]["state"])] != self.states[-1:]:
            self.states.append(State(int(last["state"]["state"])))


def ordered(monkeypatch: pytest.MonkeyPatch, orders: Listed[Order]) -> None:
    """After the scenario's own commands, once the first order is due, these alone."""
    left, told = list(orders), Operated.next

    def told_then_ordered(script: Operated, sequence: Any) -> Operator:
        state, elapsed_s, operator = left[0] if left else (None, 0.0, Operator.NONE)
        if sequence.state is state and sequence.elapsed >= elapsed_s:
            left.pop(0)
            return operator
        return told(script, sequence) if len(left) == len(orders) else Operator.NONE

    monkeypatch.setattr(Operated, "next", told_then_ordered)


@pytest.mark.parametrize(
    ("policy", "reset_s"),
    [pytest.param("use", 0.7, marks=pytest.mark.wide), ("require", 0.718)],
)
def test_arming_after_an_emergency_stop(
    monkeypatch: pytest.MonkeyPatch, policy: str, reset_s: float
) -> None:
    """The platform has come down without power, so that all drums have turned under one torque; and
    drives are configured anew, at a phase in which a single heartbeat once fell between."""
    orders = [
        (State.ACTIVE, 0.3, Operator.ESTOP),
        (State.FAULT, reset_s, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    config, _ = configured(**ROBOT, **{"supervisor.policy": policy})
    run = Noted(config, load_scenario("hold"), at=0.2)
    run.play(1.9)
    assert run.states[-4:] == [State.ACTIVE, State.FAULT, State.STANDBY, State.REFERENCING]
    assert (run.said, run.stopped_ns) == ([], {})


def test_a_drive_that_has_a_fault_when_it_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon resets it by SDO before the supervisor has begun, which is no power."""
    config, _ = configured(**ROBOT, **{"supervisor.policy": "require"})
    run = Noted(config, load_scenario("hold"), at=0.1)
    configure = Node.configure

    async def with_a_fault(node: Node, *given: Any) -> None:
        if node.node_id == 1:
            assert run._playing.lab is not None
            run._playing.lab.drives[0].fail(FOLLOWING_ERROR)
        await configure(node, *given)

    monkeypatch.setattr(Node, "configure", with_a_fault)
    run.play(0.1)
    assert run.states[-1] is State.ACTIVE
    assert (run.said, run.stopped_ns) == ([], {})


class Written(Noted):
    """Another master writes ``requests``, a while after the reset of an emergency stop."""

    after_s = 0.3
    requests: tuple[tuple[int, int, int, int], ...] = ()
    """node, index, subindex, and value of 32 bits"""
    ramps: tuple[int, ...] = ()
    """of each drive, in the lab"""
    scales: tuple[bytes, ...] = ()
    """each that the contact cell's amplifier has had"""

    def _before_tick(self, playing: Any) -> None:
        super()._before_tick(playing)
        last = playing._cycles.last
        if last is None:
            return
        self.ramps = tuple(drive.objects.number(_RAMP, 0) for drive in playing.lab.drives)
        amplifier = playing.lab.nodes[CHANNEL[_AMPLIFIER], _AMPLIFIER].device
        scale = amplifier.objects.read(_SCALE, 1)
        if self.scales[-1:] != (scale,):
            self.scales += (scale,)
        state = last["state"]
        waited = state["state"] == State.STANDBY and state["elapsed"] >= self.after_s
        if State.FAULT in self.states and not self.changed_ns and waited:
            self.changed_ns = clock.now_ns()
            self.write()

    def write(self) -> None:
        for node, index, subindex, value in self.requests:
            self._buses[self._channels().index(CHANNEL[node])].send(
                can.Message(
                    arbitration_id=0x600 + node,
                    data=struct.pack("<BHBI", 0x23, index, subindex, value),
                    is_extended_id=False,
                )
            )


@pytest.mark.parametrize(
    ("requests", "stopped"),
    [
        pytest.param(((3, _RAMP, 0, 1),), 8, id="ramp", marks=pytest.mark.wide),
        pytest.param(((3, 0x1016, 2, 0), (3, _RAMP, 0, 1)), 7, id="heartbeat consumer and ramp"),
        pytest.param(((_AMPLIFIER, _SCALE, 1, 0x43160000),), 8, id="scale of the contact cell"),
    ],
)
def test_a_device_that_another_master_writes_to_in_standby(
    monkeypatch: pytest.MonkeyPatch, requests: Any, stopped: int
) -> None:
    """A ramp on which a stop never ends. All stop, but for one that does not wait for the heartbeat
    any more, and the reset brings all up again, so that the robot may be armed."""
    orders = [
        (State.ACTIVE, 0.1, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.2, Operator.NONE),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    config, _ = configured(**ROBOT, **{"supervisor.policy": "require"})
    run = Written(config, load_scenario("hold"), at=60.0)
    run.requests = requests
    run.play(2.5)
    after = run.states[run.states.index(State.FAULT) :]
    assert after[1:5] == [State.STANDBY, State.FAULT, State.STANDBY, State.REFERENCING]
    assert len(run.stopped_ns) == stopped
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    assert len(set(run.ramps)) == 1
    assert run.scales[-1] == run.scales[0]
    assert len(run.scales) == (3 if requests[0][0] == _AMPLIFIER else 1)


@pytest.mark.parametrize(
    ("arm_s", "pause"),
    [
        (0.334, 0),
        pytest.param(0.38, 0, marks=pytest.mark.wide),
        pytest.param(0.9, 0, marks=pytest.mark.wide),
        (0.9, 12),
        pytest.param(0.9, 400, marks=pytest.mark.wide),
    ],
)
def test_drives_that_another_master_has_wait_for_no_heartbeat(
    monkeypatch: pytest.MonkeyPatch, arm_s: float, pause: int
) -> None:
    """None of them stops: what demands the reset that brings them up is that it is not armed, also
    at once, between two self-tests. The record pauses by so many ticks meanwhile."""
    orders = [
        (State.ACTIVE, 0.1, Operator.ESTOP),
        (State.FAULT, 0.7, Operator.RESET),
        (State.STANDBY, arm_s, Operator.ARM),
        (State.STANDBY, 1.0, Operator.ESTOP),
        (State.FAULT, 0.5, Operator.RESET),
        (State.STANDBY, 0.5, Operator.ARM),
    ]
    ordered(monkeypatch, orders)
    config, _ = configured(**ROBOT, **{"supervisor.policy": "require"})
    run = Written(config, load_scenario("hold"), at=60.0)
    run.requests = tuple((node, 0x1016, 2, 0) for node in DRIVES)
    publish = Overheard.publish

    def published(ring: Overheard, payload: Any, stamp_ns: int) -> None:
        if not run.changed_ns or stamp_ns > run.changed_ns + pause * 1_000_000:
            publish(ring, payload, stamp_ns)

    monkeypatch.setattr(Overheard, "publish", published)
    run.play(3.0)
    after = run.states[run.states.index(State.FAULT) :]
    assert after[1:5] == [State.STANDBY, State.FAULT, State.STANDBY, State.REFERENCING]
    assert not run.stopped_ns
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}


@pytest.mark.parametrize(
    "nodes",
    [tuple(DRIVES), pytest.param((3,), marks=pytest.mark.wide)],
    ids=["all", "one"],
)
def test_drives_in_action_that_another_master_has_wait_for_no_heartbeat(
    nodes: tuple[int, ...],
) -> None:
    """The daemon stops the robot, since the supervisor could not: with those that stay enabled,
    be they all, or one."""
    config, _ = configured(**ROBOT, **{"supervisor.policy": "require"})
    run = Written(config, load_scenario("hold"), at=0.3)
    run.change = run.write
    run.requests = tuple((node, 0x1016, 2, 0) for node in nodes)
    seen = run.play(3.0)
    assert len(run.stopped_ns) == len(DRIVES) - len(nodes)
    assert {number for number, _ in run.said} == {Requirement.COMMANDED}
    after = seen.cycle_ns >= run.changed_ns
    stopped = after & (seen.state == State.SAFE_STOP)
    late_ms = (seen.cycle_ns[stopped][0] - run.changed_ns) * 1e-6
    assert set(seen.cycle["state"]["fault"][stopped]) == {Fault.SUPERVISOR_IGNORED}
    last = StopMode.ON_PATH if len(nodes) == len(DRIVES) else StopMode.PASSIVE
    assert seen.cycle["state"]["stop_mode"][stopped][-1] == last
    assert {"supervisor_lost", "supervisor_ignored"} <= {each.name for each in seen.events}
    timeout_ms = ROBOT["supervisor.timeout_ms"]
    assert 2 * timeout_ms - 1 <= late_ms <= 2 * timeout_ms + 6, "behind the last heartbeat"
    assert seen.state[-1] == State.FAULT
    assert first_difference(seen) is None
