"""A drive on its bus never leaves the published CiA 402 machine, whatever it is told.

The model is the published table and knows nothing of the emulator. Where the table leaves something
open (which commands are heard during a ramp) the model keeps every place the drive may be in, and
what the statusword shows decides.
"""

from __future__ import annotations

import itertools
import struct
from typing import NamedTuple

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from lab_bench import Bench

from tonus.config.schema.faults import DriveError

CHANNEL, NODE = "can0", 1
DISABLED, READY, ON, ENABLED = "switch on disabled", "ready", "switched on", "operation enabled"
STOPPED, REACTION, FAULT = "quick stop active", "fault reaction active", "fault"
# State: mask and value of the statusword.
SHOWN = {
    DISABLED: (0x4F, 0x40),
    READY: (0x6F, 0x21),
    ON: (0x6F, 0x23),
    ENABLED: (0x6F, 0x27),
    STOPPED: (0x6F, 0x07),
    REACTION: (0x4F, 0x0F),
    FAULT: (0x4F, 0x08),
}
# Command: mask and value of the controlword. "switch on" is also called "disable operation".
COMMANDS = {
    "shutdown": (0x87, 0x06),
    "switch on": (0x8F, 0x07),
    "enable": (0x8F, 0x0F),
    "disable voltage": (0x82, 0x00),
    "quick stop": (0x86, 0x02),
}
TRANSITIONS = {
    (DISABLED, "shutdown"): READY,  # 2
    (READY, "switch on"): ON,  # 3
    (READY, "enable"): ENABLED,  # 3, 4
    (ON, "enable"): ENABLED,  # 4
    (ENABLED, "switch on"): ON,  # 5, as 0x605C says
    (ON, "shutdown"): READY,  # 6
    (READY, "disable voltage"): DISABLED,  # 7
    (READY, "quick stop"): DISABLED,  # 7
    (ENABLED, "shutdown"): READY,  # 8, as 0x605B says
    (ENABLED, "disable voltage"): DISABLED,  # 9
    (ON, "disable voltage"): DISABLED,  # 10
    (ON, "quick stop"): DISABLED,  # 10
    (ENABLED, "quick stop"): STOPPED,  # 11
    (STOPPED, "disable voltage"): DISABLED,  # 12
    (STOPPED, "enable"): ENABLED,  # 16
}
POWERED = (ENABLED, STOPPED)
SHUTDOWN_OPTION, DISABLE_OPTION, CONNECTION_OPTION, FAULT_OPTION = 0x605B, 0x605C, 0x6007, 0x605E
DEFAULTS = {SHUTDOWN_OPTION: 0, DISABLE_OPTION: 1, CONNECTION_OPTION: 3, FAULT_OPTION: 2}
ACCEPTED = {
    SHUTDOWN_OPTION: (0, 1),
    DISABLE_OPTION: (0, 1),
    CONNECTION_OPTION: (2, 3),
    FAULT_OPTION: (0, 1, 2),
}
# Error code: the option that decides on its reaction, or None: power off at once.
ERRORS = {
    0x2310: None,
    0x7320: None,
    0x8150: CONNECTION_OPTION,
    0x8120: CONNECTION_OPTION,
    0x8130: CONNECTION_OPTION,
    0x6320: FAULT_OPTION,
    0x8611: FAULT_OPTION,
}
AT_ONCE = {CONNECTION_OPTION: 2, FAULT_OPTION: 0}
"""With this option no ramp is run either."""
OF_THE_BUS = (0x8120, 0x8130)
"""Held until NMT reset communication."""
DECELERATION = 3000
"""rpm/s"""
RAMP_MS = 2500
"""Deceleration from any speed a drum has here, and the timeout of the standstill window."""
_TYPICAL = st.sampled_from([0x02, 0x06, 0x07, 0x0F, 0x00, 0x80])
WORDS = st.one_of(_TYPICAL, _TYPICAL, st.integers(min_value=0, max_value=0xFF))
EVENTS = st.sampled_from([0x00, 0x80, 0x0F, *ERRORS])
WAYS_UP = st.sampled_from([(0x06, 0x0F), (0x06, 0x07, 0x0F), (0x06, 0x07), (0x06,)])


class Place(NamedTuple):
    """A state, and the state that a ramp in it leads to."""

    state: str
    goal: str | None = None


def command(word: int) -> str | None:
    found = [name for name, (mask, value) in COMMANDS.items() if word & mask == value]
    assert len(found) <= 1
    return found[0] if found else None


class DriveOnItsBus(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench()
        self.bench.wait(2)
        self.places = {Place(DISABLED)}
        self.nmt = "pre-operational"
        self.started()

    def started(self) -> None:
        """What a reset of the node makes of it."""
        self.options = dict(DEFAULTS)
        self.held = False
        self.last_word: int | None = None
        """None after a start: whether a bit that is set then has risen is open"""

    def teardown(self) -> None:
        self.bench.__exit__(None, None, None)

    # -- the model -------------------------------------------------------------------------------

    def told(self, place: Place, word: int) -> set[Place]:
        """Where a controlword may lead."""
        if place.state == FAULT:
            if not word & 0x80 or self.held:
                return {place}
            if self.last_word is None:
                return {place, Place(DISABLED)}
            return {place} if self.last_word & 0x80 else {Place(DISABLED)}
        name = command(word)
        if place.state == REACTION or name is None:
            return {place}
        to = TRANSITIONS.get((place.state, name))
        if to is None:
            return {place}
        option = {"shutdown": SHUTDOWN_OPTION, "switch on": DISABLE_OPTION}.get(name)
        if place.state == ENABLED and option is not None and self.options[option] == 1:
            reached = {Place(ENABLED, to)}
        else:
            reached = {Place(to)}
        if place.goal is not None and to not in (DISABLED, STOPPED):
            reached.add(place)  # it may finish its ramp first
        return reached

    def failed(self, code: int) -> None:
        self.passed()
        option = ERRORS[code]
        ramp = option is not None and self.options[option] != AT_ONCE[option]
        self.held |= code in OF_THE_BUS
        reached: set[Place] = set()
        for place in self.places:
            if place.state in (FAULT, REACTION):
                reached |= {place, Place(FAULT)}
            elif place.state in POWERED and ramp:
                reached.add(Place(REACTION, FAULT))
            else:
                reached.add(Place(FAULT))
        self.places = reached

    def passed(self) -> None:
        """Some milliseconds: a ramp may have ended."""
        self.places |= {Place(place.goal) for place in self.places if place.goal is not None}

    # -- the bus ---------------------------------------------------------------------------------

    def choose_torque_mode(self) -> None:
        """And ramps that are slow enough to be spoken to."""
        self.object(0x6060, 10, 1)
        self.object(0x6084, DECELERATION, 4)
        self.object(0x6085, DECELERATION, 4)

    def object(self, index: int, value: int, size: int = 2) -> None:
        assert self.bench.write(CHANNEL, NODE, index, 0, value, size) == 0

    @property
    def talks(self) -> bool:
        return self.nmt != "stopped"

    def word_arrived(self, word: int) -> None:
        self.passed()
        self.places = {to for place in self.places for to in self.told(place, word)}
        self.last_word = word

    @initialize()
    def begin(self) -> None:
        self.choose_torque_mode()

    @precondition(lambda self: self.talks)
    @rule(word=WORDS)
    def controlword_by_sdo(self, word: int) -> None:
        self.object(0x6040, word)
        self.word_arrived(word)

    @rule(word=WORDS)
    def controlword_by_pdo(self, word: int) -> None:
        """By RPDO1 as it is from the factory; heard in operational only."""
        self.bench.send(CHANNEL, 0x200 + NODE, struct.pack("<H", word))
        self.bench.wait(1)
        if self.nmt == "operational":
            self.word_arrived(word)

    @precondition(lambda self: self.talks)
    @rule(
        reset=st.sampled_from([True, True, False]),
        way_up=WAYS_UP,
        torque=st.sampled_from([0, 500, -500]),
        then=st.lists(WORDS | EVENTS, min_size=1, max_size=4) | st.lists(EVENTS, min_size=2),
    )
    def up_and_on(self, reset: bool, way_up: tuple[int, ...], torque: int, then: list[int]) -> None:
        """The words a master sends in a row, which chance rarely does; some motion; and more
        words and errors in close succession."""
        self.object(0x6071, torque)
        for word in ((0x00, 0x80, 0x00) if reset else ()) + way_up:
            self.controlword_by_sdo(word)
        self.bench.wait(40 if torque else 0)
        for one in then:
            self.step(one)

    def step(self, one: int) -> None:
        """A controlword or an error, and a look."""
        if one in ERRORS:
            self.error(one)
        else:
            self.controlword_by_sdo(one)
        self.shows_a_place_it_may_be_in()

    @precondition(lambda self: self.talks)
    @rule(data=st.data())
    def option_code(self, data: st.DataObject) -> None:
        index = data.draw(st.sampled_from(sorted(ACCEPTED)))
        value = data.draw(st.sampled_from(ACCEPTED[index]))
        self.object(index, value)
        self.options[index] = value

    @rule(code=st.sampled_from(sorted(ERRORS)))
    def error(self, code: int) -> None:
        self.bench.lab.inject(DriveError(kind="drive_error", channel=CHANNEL, node=NODE, code=code))
        self.bench.wait(1)
        self.failed(code)

    @rule(to=st.sampled_from(["operational", "operational", "stopped", "pre-operational"]))
    def nmt_command(self, to: str) -> None:
        """Of no effect on the machine: a drive without a watch keeps what it was told."""
        self.nmt_sent({"operational": 0x01, "stopped": 0x02, "pre-operational": 0x80}[to])
        self.nmt = to

    @rule(node=st.booleans())
    def nmt_reset(self, node: bool) -> None:
        """Of communication: of no effect on the machine either, but it frees the bus's errors."""
        self.nmt_sent(0x81 if node else 0x82)
        self.nmt = "pre-operational"
        self.held = False
        if node:
            self.places = {Place(DISABLED)}
            self.started()
            self.choose_torque_mode()

    def nmt_sent(self, command: int) -> None:
        self.bench.send(CHANNEL, 0x000, bytes((command, NODE)))
        self.bench.wait(2)

    @precondition(lambda self: any(place.goal for place in self.places))
    @rule()
    def let_ramps_end(self) -> None:
        self.bench.wait(RAMP_MS)
        self.places = {Place(place.goal) if place.goal else place for place in self.places}

    @invariant()
    def shows_a_place_it_may_be_in(self) -> None:
        self.passed()
        if not self.talks:
            return
        word = int.from_bytes(self.bench.upload(CHANNEL, NODE, 0x6041, 0), "little")
        shown = [name for name, (mask, value) in SHOWN.items() if word & mask == value]
        assert len(shown) == 1, f"0x{word:04X} is no state"
        left = {place for place in self.places if place.state == shown[0]}
        assert left, f"{shown[0]}, but it can only be one of {self.places}"
        self.places = left
        assert word & 0x0010, "there is voltage"
        assert bool(word & 0x0200) == (self.nmt == "operational")
        if all(place.goal is None for place in left):  # else the ramp may have ended since
            powered = bool(self.bench.lab.plant.powered[0])
            assert powered == (shown[0] in POWERED)

    @invariant()
    def is_at_rest_without_power(self) -> None:
        plant = self.bench.lab.plant
        assert plant.powered[0] or plant.current_reference[0] == 0.0


TestDriveOnItsBus = DriveOnItsBus.TestCase
TestDriveOnItsBus.settings = settings(
    max_examples=25,
    stateful_step_count=50,
    derandomize=True,
    deadline=None,
    phases=(Phase.generate,),  # making a sequence shorter takes minutes
)


STEPS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F, 0x2310, 0x6320, 0x8130)
PATHS = {
    DISABLED: (),
    READY: (0x06,),
    ON: (0x06, 0x07),
    ENABLED: (0x06, 0x0F),
    STOPPED: (0x06, 0x0F, 0x02),
    REACTION: (0x06, 0x0F, 0x6320),
    FAULT: (0x80, 0x2310),
}


@pytest.mark.parametrize("state", PATHS)
def test_from_every_state_any_two_steps(state: str) -> None:
    drive = DriveOnItsBus()
    try:
        for number, steps in enumerate(itertools.product(STEPS, repeat=2)):
            drive.nmt_reset(node=True)
            drive.object(SHUTDOWN_OPTION, 1)
            drive.options[SHUTDOWN_OPTION] = 1
            drive.object(0x6071, -500 if number % 2 else 500)
            for one in PATHS[state]:
                drive.step(one)
                drive.bench.wait(20 if one == 0x0F else 0)  # some speed, for a ramp that lasts
            assert {place.state for place in drive.places} & {state, FAULT}
            for one in steps:
                drive.step(one)
    finally:
        drive.teardown()
