"""Statuswords to states, and the way from any state to what is commanded."""

from __future__ import annotations

import pytest

from tonus.drivers.devices.cia402 import DISABLE_VOLTAGE, controlword, decode
from tonus.drivers.process_image import AxisCommand, AxisState

S = AxisState
# Bits 3 2 1 0 of the statusword, with bit 6, and bit 5 where it means something (CiA 402).
NAMED = {
    (0, 0b0000, None): S.NOT_READY,
    (1, 0b0000, None): S.SWITCH_ON_DISABLED,
    (0, 0b0001, 1): S.READY_TO_SWITCH_ON,
    (0, 0b0011, 1): S.SWITCHED_ON,
    (0, 0b0111, 1): S.OPERATION_ENABLED,
    (0, 0b0111, 0): S.QUICK_STOP_ACTIVE,
    (0, 0b1111, None): S.FAULT_REACTION_ACTIVE,
    (0, 0b1000, None): S.FAULT,
}


def test_every_statusword_reads_as_the_published_table_says() -> None:
    for word in range(0x10000):
        bit6, bit5, low = word >> 6 & 1, word >> 5 & 1, word & 0xF
        expected = NAMED.get((bit6, low, None), NAMED.get((bit6, low, bit5), S.NOT_READY))
        assert decode(word) is expected, hex(word)


# The drive's side, written from the transition table: (state, word pattern) to next state.
def react(state: AxisState, word: int, before: int) -> AxisState:
    low = word & 0x0F
    if state is S.FAULT:
        return S.SWITCH_ON_DISABLED if word & 0x80 and not before & 0x80 else S.FAULT
    if not low & 0x02:  # disable voltage
        return S.SWITCH_ON_DISABLED
    if not low & 0x04:  # quick stop
        if state is S.OPERATION_ENABLED:
            return S.QUICK_STOP_ACTIVE
        if state in (S.READY_TO_SWITCH_ON, S.SWITCHED_ON):
            return S.SWITCH_ON_DISABLED
        return state
    if not low & 0x01:  # shutdown
        return state if state is S.QUICK_STOP_ACTIVE else S.READY_TO_SWITCH_ON
    if not low & 0x08:  # switch on, disable operation
        if state in (S.READY_TO_SWITCH_ON, S.OPERATION_ENABLED):
            return S.SWITCHED_ON
        return state
    if state in (S.SWITCHED_ON, S.QUICK_STOP_ACTIVE):
        return S.OPERATION_ENABLED
    return state if state is not S.READY_TO_SWITCH_ON else S.OPERATION_ENABLED


class Axis:
    """Remembers the word before."""

    def __init__(self) -> None:
        self._last = DISABLE_VOLTAGE

    def controlword(self, state: int, command: int) -> int:
        self._last = controlword(state, command, self._last)
        return self._last


def walk(state: AxisState, command: AxisCommand, delay: int, steps: int = 40) -> list[AxisState]:
    """Drive and axis in a loop whose feedback comes ``delay`` ticks late."""
    axis = Axis()
    seen, before = [state], 0
    for _ in range(steps):
        word = axis.controlword(seen[max(0, len(seen) - 1 - delay)], command)
        seen.append(react(seen[-1], word, before))
        before = word
    return seen


@pytest.mark.parametrize("delay", [0, 2, 3])
def test_enable_passes_through_every_state_in_order(delay: int) -> None:
    seen = walk(S.SWITCH_ON_DISABLED, AxisCommand.ENABLE, delay)
    assert list(dict.fromkeys(seen)) == [
        S.SWITCH_ON_DISABLED,
        S.READY_TO_SWITCH_ON,
        S.SWITCHED_ON,
        S.OPERATION_ENABLED,
    ]
    assert seen[-1] is S.OPERATION_ENABLED


@pytest.mark.parametrize("delay", [0, 2, 3])
def test_disable_goes_back_the_same_way(delay: int) -> None:
    seen = walk(S.OPERATION_ENABLED, AxisCommand.DISABLE, delay)
    assert list(dict.fromkeys(seen)) == [
        S.OPERATION_ENABLED,
        S.SWITCHED_ON,
        S.READY_TO_SWITCH_ON,
        S.SWITCH_ON_DISABLED,
    ]


def test_quick_stop_holds_until_something_else_is_commanded() -> None:
    assert walk(S.OPERATION_ENABLED, AxisCommand.QUICK_STOP, 2)[-1] is S.QUICK_STOP_ACTIVE
    assert walk(S.QUICK_STOP_ACTIVE, AxisCommand.ENABLE, 2)[-1] is S.OPERATION_ENABLED
    assert walk(S.QUICK_STOP_ACTIVE, AxisCommand.DISABLE, 2)[-1] is S.SWITCH_ON_DISABLED


def test_a_fault_is_left_by_reset_alone() -> None:
    for command in (AxisCommand.ENABLE, AxisCommand.DISABLE, AxisCommand.QUICK_STOP):
        assert walk(S.FAULT, command, 2)[-1] is S.FAULT
    assert walk(S.FAULT, AxisCommand.RESET_FAULT, 2)[-1] is S.SWITCH_ON_DISABLED


def test_a_fault_reset_is_an_edge_and_is_repeated_as_one() -> None:
    axis = Axis()
    axis.controlword(S.OPERATION_ENABLED, AxisCommand.ENABLE)
    words = [axis.controlword(S.FAULT, AxisCommand.RESET_FAULT) for _ in range(6)]
    assert words == [0x00, 0x80, 0x00, 0x80, 0x00, 0x80]


def test_no_command_ever_jumps_from_disabled_to_enabled() -> None:
    for command in range(256):
        assert Axis().controlword(S.SWITCH_ON_DISABLED, command) != 0x0F
        assert Axis().controlword(S.LOST, command) in (0x00, 0x02)


def test_a_lost_drive_keeps_the_word_it_had_but_not_a_reset() -> None:
    axis = Axis()
    axis.controlword(S.SWITCHED_ON, AxisCommand.ENABLE)
    assert axis.controlword(S.LOST, AxisCommand.ENABLE) == 0x0F
    assert axis.controlword(S.LOST, AxisCommand.DISABLE) == 0x00
    axis.controlword(S.FAULT, AxisCommand.RESET_FAULT)
    axis.controlword(S.FAULT, AxisCommand.RESET_FAULT)
    assert axis.controlword(S.LOST, AxisCommand.ENABLE) == 0x00


@pytest.mark.parametrize("command", [len(AxisCommand), 200, 255])
def test_a_number_that_is_no_command_disables(command: int) -> None:
    for state in AxisState:
        for last in (0x00, 0x0F, 0x80):
            wanted = controlword(state, AxisCommand.DISABLE, last)
            assert controlword(state, command, last) == wanted
