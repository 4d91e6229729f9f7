"""Every state times every command against the published table."""

from __future__ import annotations

import pytest

from sim.devices.cia402 import Machine, State

S = State
SHUTDOWN, SWITCH_ON, ENABLE, VOLTAGE, QUICK = 0x06, 0x07, 0x0F, 0x00, 0x02
TABLE = {
    # state: shutdown, switch on, enable, disable voltage, quick stop
    S.SWITCH_ON_DISABLED: (S.READY, None, None, None, None),
    S.READY: (None, S.SWITCHED_ON, S.OPERATION_ENABLED, S.SWITCH_ON_DISABLED, S.SWITCH_ON_DISABLED),
    S.SWITCHED_ON: (
        S.READY,
        None,
        S.OPERATION_ENABLED,
        S.SWITCH_ON_DISABLED,
        S.SWITCH_ON_DISABLED,
    ),
    S.OPERATION_ENABLED: (
        S.READY,
        S.SWITCHED_ON,
        None,
        S.SWITCH_ON_DISABLED,
        S.QUICK_STOP_ACTIVE,
    ),
    S.QUICK_STOP_ACTIVE: (None, None, S.OPERATION_ENABLED, S.SWITCH_ON_DISABLED, None),
    S.FAULT_REACTION_ACTIVE: (None, None, None, None, None),
    S.FAULT: (None, None, None, None, None),
    S.NOT_READY: (None, None, None, None, None),
}
WAY = {
    S.NOT_READY: None,
    S.SWITCH_ON_DISABLED: (),
    S.READY: (SHUTDOWN,),
    S.SWITCHED_ON: (SHUTDOWN, SWITCH_ON),
    S.OPERATION_ENABLED: (SHUTDOWN, ENABLE),
    S.QUICK_STOP_ACTIVE: (SHUTDOWN, ENABLE, QUICK),
}


class Stage:
    """A power stage that remembers; ``ramps``: what 0x605B and 0x605C say."""

    def __init__(self, ramps: bool = False) -> None:
        self.on = False
        self.braking = False
        self.ramps = ramps
        self.cause = False
        self.cleared = 0
        self.allowed = True

    def power(self, on: bool) -> None:
        self.on, self.braking = on, False

    def ramp_down(self, then: State) -> None:
        self.braking = True

    def resettable(self) -> bool:
        return not self.cause

    def fault_cleared(self) -> None:
        self.cleared += 1

    def may_enable(self) -> bool:
        return self.allowed

    def shutdown_ramp(self) -> bool:
        return self.ramps

    def disable_ramp(self) -> bool:
        return self.ramps


def machine_in(state: State, ramps: bool = False) -> tuple[Machine, Stage]:
    stage = Stage(ramps)
    machine = Machine(stage)
    if state is S.NOT_READY:
        return machine, stage
    machine.start()
    if state in (S.FAULT, S.FAULT_REACTION_ACTIVE):
        for word in (SHUTDOWN, ENABLE):
            machine.controlword(word)
        machine.fault(ramp=state is S.FAULT_REACTION_ACTIVE)
    else:
        for word in WAY[state]:
            machine.controlword(word)
    assert machine.state is state
    return machine, stage


@pytest.mark.parametrize("state", list(TABLE))
@pytest.mark.parametrize("place", range(5))
def test_every_state_and_command(state: State, place: int) -> None:
    # Bits that a command does not care about must not matter.
    for extra in (0x00, 0x10, 0x60, 0x100, 0xF800):
        machine, stage = machine_in(state)
        command = (SHUTDOWN, SWITCH_ON, ENABLE, VOLTAGE, QUICK)[place]
        machine.controlword(command | extra)
        wanted = TABLE[state][place] or state
        assert machine.state is wanted
        powered = wanted in (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE)
        assert stage.on is powered
        assert stage.braking is (wanted in (S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE))


def test_a_fault_is_reset_by_an_edge_only() -> None:
    machine, stage = machine_in(S.FAULT)
    machine.controlword(0x80)
    assert machine.state is S.SWITCH_ON_DISABLED
    machine.fault(ramp=False)
    machine.controlword(0x80)
    assert machine.state is S.FAULT, "bit 7 was held"
    machine.controlword(0x00)
    machine.controlword(0x80)
    assert machine.state is S.SWITCH_ON_DISABLED
    assert stage.cleared == 2


def test_a_cause_that_remains_keeps_the_fault() -> None:
    machine, stage = machine_in(S.FAULT)
    stage.cause = True
    machine.controlword(0x80)
    assert machine.state is S.FAULT


def test_the_fault_reaction_ends_in_fault_without_power() -> None:
    machine, stage = machine_in(S.FAULT_REACTION_ACTIVE)
    machine.ramp_ended()
    assert machine.state is S.FAULT
    assert not stage.on


@pytest.mark.parametrize(("word", "end"), [(SWITCH_ON, S.SWITCHED_ON), (SHUTDOWN, S.READY)])
def test_with_a_ramp_the_drive_brakes_before_it_leaves(word: int, end: State) -> None:
    machine, stage = machine_in(S.OPERATION_ENABLED, ramps=True)
    machine.controlword(word)
    assert machine.state is S.OPERATION_ENABLED
    assert stage.braking
    machine.ramp_ended()
    assert machine.state is end
    assert not stage.on
