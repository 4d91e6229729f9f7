"""Every state times every command against the published table: the machine, then a whole drive."""

from __future__ import annotations

import pytest
from one_drive import OneDrive

from tonus.sim.devices.cia402.states import Machine, State
from tonus.sim.devices.objects import RANGE, AbortError

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
        self.quick_stop = 6

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

    def quick_stop_option(self) -> int:
        return self.quick_stop


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


def test_what_the_terminals_forbid_is_not_enabled() -> None:
    for state in (S.READY, S.SWITCHED_ON, S.QUICK_STOP_ACTIVE):
        machine, stage = machine_in(state)
        stage.allowed = False
        machine.controlword(ENABLE)
        assert machine.state is state


# -- the whole drive -----------------------------------------------------------------------------

COMMANDS = (SHUTDOWN, SWITCH_ON, ENABLE, VOLTAGE, QUICK)
BITS = {
    # The maker's values under the mask 0x6F.
    S.SWITCH_ON_DISABLED: 0x40,
    S.READY: 0x21,
    S.SWITCHED_ON: 0x23,
    S.OPERATION_ENABLED: 0x27,
    S.QUICK_STOP_ACTIVE: 0x07,
    S.FAULT_REACTION_ACTIVE: 0x0F,
    S.FAULT: 0x08,
}
RAMP = 5000
"""rpm/s"""
POWERED = (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE)


def drive_in(state: State) -> OneDrive:
    """A drive in cyclic synchronous torque whose motor, where it has power, turns."""
    bench = OneDrive()
    bench.write(0x6060, 0, 10)
    bench.write(0x6084, 0, RAMP)
    bench.write(0x6085, 0, RAMP)
    bench.drive.controlword(0)
    bench.drive.target_torque(60)
    if state in POWERED:
        bench.enable()
        bench.wait(200)
        assert bench.rpm > 150.0
    if state is S.QUICK_STOP_ACTIVE:
        bench.drive.controlword(QUICK)
    elif state is S.FAULT_REACTION_ACTIVE:
        bench.drive.fail(0x8611)
    elif state is S.FAULT:
        bench.drive.fail(0x1000)
    elif state not in POWERED:
        for word in WAY[state] or ():
            bench.drive.controlword(word)
    assert bench.drive.state is state
    return bench


@pytest.mark.parametrize("ramps", [False, True], ids=["at once", "with ramps"])
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", BITS, ids=lambda state: state.name)
def test_a_drive_answers_every_command_in_every_state(
    state: State, command: int, ramps: bool
) -> None:
    bench = drive_in(state)
    bench.write(0x605B, 0, ramps)
    bench.write(0x605C, 0, ramps)
    before = bench.rpm
    wanted = TABLE[state][COMMANDS.index(command)] or state
    leaves = state is S.OPERATION_ENABLED and wanted in (S.READY, S.SWITCHED_ON)
    bench.drive.controlword(command)
    at_once = state if leaves and ramps else wanted
    assert bench.drive.state is at_once
    assert bench.word & 0x6F == BITS[at_once]
    assert bench.powered is (at_once in POWERED)
    bench.wait(20)
    if wanted is S.OPERATION_ENABLED:
        assert bench.rpm > before, "it follows its torque"
    elif bench.powered:
        assert bench.read(0x606B) == pytest.approx(before - 0.02 * RAMP, abs=15), "it brakes"
    bench.wait(600)
    end = {S.FAULT_REACTION_ACTIVE: S.FAULT}.get(wanted, wanted)
    assert bench.drive.state is end
    assert bench.word & 0x6F == BITS[end]
    assert bench.powered is (end in POWERED)
    if end is S.QUICK_STOP_ACTIVE:
        assert abs(bench.rpm) < 3.0, "held"


@pytest.mark.parametrize("state", BITS, ids=lambda state: state.name)
def test_a_fault_reset_does_nothing_but_in_fault(state: State) -> None:
    bench = drive_in(state)
    bench.drive.controlword(0x80)
    assert bench.drive.state is (S.SWITCH_ON_DISABLED if state is S.FAULT else state)


@pytest.mark.parametrize(
    ("index", "taken", "refused"),
    [
        (0x605A, (6,), (-1, 0, 1, 2, 3, 4, 5, 7)),
        (0x605B, (0, 1), (-1, 2)),
        (0x605C, (0, 1), (-1, 2)),
        (0x605E, (0, 1, 2), (-1, 3, 4)),
        (0x6007, (2, 3), (-1, 0, 1, 4)),
    ],
)
def test_option_codes_are_those_of_the_drive(
    index: int, taken: tuple[int, ...], refused: tuple[int, ...]
) -> None:
    bench = OneDrive()
    for value in taken:
        bench.write(index, 0, value)
        assert bench.read(index) == value
    for value in refused:
        with pytest.raises(AbortError) as abort:
            bench.write(index, 0, value)
        assert abort.value.code == RANGE
    assert bench.read(index) == taken[-1]


def test_holding_bit_7_does_not_reset_the_next_fault() -> None:
    bench = drive_in(S.FAULT)
    bench.drive.controlword(0x80)
    bench.drive.fail(0x1000)
    bench.drive.controlword(0x80)
    assert bench.drive.state is S.FAULT
