"""No sequence of commands, errors, wires and waits leaves the drive's published state table."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from one_drive import BRAKE, OneDrive

from tonus.sim.devices.cia402.states import State
from tonus.sim.devices.epos4.errors import ERRORS

S = State
# Transitions by number, as published: state, and the word that asks for it in bits 0 to 3.
SHUTDOWN, SWITCH_ON, ENABLE, VOLTAGE, QUICK = "shutdown", "switch on", "enable", "voltage", "quick"
TRANSITIONS = {
    (S.SWITCH_ON_DISABLED, SHUTDOWN): S.READY,
    (S.READY, SWITCH_ON): S.SWITCHED_ON,
    (S.READY, ENABLE): S.OPERATION_ENABLED,
    (S.SWITCHED_ON, ENABLE): S.OPERATION_ENABLED,
    (S.OPERATION_ENABLED, SWITCH_ON): S.SWITCHED_ON,
    (S.SWITCHED_ON, SHUTDOWN): S.READY,
    (S.READY, VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.READY, QUICK): S.SWITCH_ON_DISABLED,
    (S.OPERATION_ENABLED, SHUTDOWN): S.READY,
    (S.OPERATION_ENABLED, VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.SWITCHED_ON, QUICK): S.SWITCH_ON_DISABLED,
    (S.OPERATION_ENABLED, QUICK): S.QUICK_STOP_ACTIVE,
    (S.QUICK_STOP_ACTIVE, VOLTAGE): S.SWITCH_ON_DISABLED,
    (S.QUICK_STOP_ACTIVE, ENABLE): S.OPERATION_ENABLED,
}
POWERED = {S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE}
COMMUNICATION = {0x8120, 0x8130}
DEVICE = {*range(0x1080, 0x1089), *range(0x5280, 0x5283), *range(0x5480, 0x5484)}


def asked(word: int) -> str:
    pattern = f"{word & 0xF:04b}"
    if pattern[2] == "0":
        return VOLTAGE
    if pattern[1] == "0":
        return QUICK
    if pattern[3] == "0":
        return SHUTDOWN
    return ENABLE if pattern[0] == "1" else SWITCH_ON


class AnySequence(RuleBasedStateMachine):
    """The model: a state, the state a ramp leads to, and the errors that need more than a reset."""

    @initialize(mode=st.sampled_from([1, 3, 6, 8, 9, 10]), brake=st.booleans())
    def begin(self, mode: int, brake: bool) -> None:
        self.bench = OneDrive(brake=BRAKE if brake else None)
        self.brake = brake
        self.bench.write(0x6065, 0, 0xFFFFFFFF)
        self.bench.write(0x6060, 0, mode)
        self.state = S.SWITCH_ON_DISABLED
        self.ramp_to: State | None = None
        self.bit_7 = True
        self.blocked: set[int] = set()
        self.torque_off = False

    @rule(
        low=st.sampled_from([0x06, 0x07, 0x0F, 0x00, 0x02, 0x80, 0x0F, 0x06]),
        high=st.sampled_from([0x00, 0x10, 0x50, 0x70, 0x100, 0x8010]),
    )
    def controlword(self, low: int, high: int) -> None:
        word = low | high
        self.bench.drive.controlword(word)
        edge = bool(word & 0x80) and not self.bit_7
        self.bit_7 = bool(word & 0x80)
        if self.state is S.FAULT:
            if edge and not self.blocked and not (self.torque_off and self.sto_error):
                self.state = S.SWITCH_ON_DISABLED
            return
        if word & 0x80 or self.state is S.FAULT_REACTION_ACTIVE:
            return
        wanted = asked(word)
        if self.ramp_to is not None and wanted not in (VOLTAGE, QUICK):
            return
        target = TRANSITIONS.get((self.state, wanted))
        if target is None:
            return
        number = self.bench.read
        if target is S.OPERATION_ENABLED and self.torque_off:
            self.state, self.ramp_to, self.sto_error = S.FAULT, None, True
        elif self.state is S.OPERATION_ENABLED and wanted in (SHUTDOWN, SWITCH_ON):
            if number(0x605B if wanted == SHUTDOWN else 0x605C):
                self.ramp_to = target
            else:
                self.state = target
        else:
            self.state, self.ramp_to = target, None

    sto_error = False

    @rule(code=st.sampled_from(sorted(ERRORS)))
    def error(self, code: int) -> None:
        self.bench.drive.fail(code)
        reaction = ERRORS[code].reaction
        if reaction == "W":
            return
        option = self.bench.read(0x605E)
        brakes = (reaction == "F" and option > 0) or (
            reaction == "A" and self.bench.read(0x6007) == 3
        )
        powered = self.state in POWERED
        self.state = S.FAULT_REACTION_ACTIVE if brakes and powered else S.FAULT
        self.ramp_to = None
        self.blocked |= {code} & (COMMUNICATION | DEVICE)
        self.sto_error = self.sto_error or code == 0x8A88

    @rule(active=st.booleans())
    def safe_torque_off(self, active: bool) -> None:
        powered = self.bench.powered
        self.torque_off = active
        self.bench.drive.set_input("sto", active)
        if active and powered:
            self.state, self.ramp_to, self.sto_error = S.FAULT, None, True

    @rule(
        index=st.sampled_from([0x605B, 0x605C, 0x605E]),
        value=st.integers(0, 1),
    )
    def option(self, index: int, value: int) -> None:
        self.bench.write(index, 0, value)

    @rule(mode=st.sampled_from([1, 3, 6, 8, 9, 10]))
    def mode(self, mode: int) -> None:
        self.bench.write(0x6060, 0, mode)

    @rule(ms=st.sampled_from([0.4, 3.0, 30.0, 1200.0]))
    def wait(self, ms: float) -> None:
        before = self.bench.drive.state
        self.bench.wait(ms)
        now = self.bench.drive.state
        # Only ramps end by themselves.
        if self.state is S.FAULT_REACTION_ACTIVE and (now is not before or ms > 1000.0):
            self.state = S.FAULT
        elif self.ramp_to is not None and (now is not before or ms > 1000.0):
            self.state, self.ramp_to = self.ramp_to, None

    @rule()
    def reset_communication(self) -> None:
        self.bench.drive.communication_reset()
        self.blocked -= COMMUNICATION

    @rule()
    def reset(self) -> None:
        self.bench.drive.reset()
        self.bench.write(0x6065, 0, 0xFFFFFFFF)
        self.state, self.ramp_to, self.bit_7 = S.SWITCH_ON_DISABLED, None, True
        self.blocked, self.sto_error = set(), False

    @invariant()
    def drive_is_where_the_table_says(self) -> None:
        if not hasattr(self, "bench"):
            return
        assert self.bench.drive.state is self.state
        assert self.bench.word & 0x6F == self.state
        if self.state in POWERED:
            assert self.bench.powered
        elif not self.brake:
            assert not self.bench.powered
        if self.state is S.SWITCH_ON_DISABLED:
            self.sto_error = False


AnySequence.TestCase.settings = settings(
    max_examples=30, stateful_step_count=30, derandomize=True, deadline=None
)
test_no_sequence_leaves_the_table = AnySequence.TestCase
