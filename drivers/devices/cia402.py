"""CiA 402 power state machine as its master sees it: statusword to state, goal to controlword."""

from __future__ import annotations

import numpy as np
from numba import njit

from tonus.drivers.process_image import AxisCommand, AxisState

SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
DISABLE_OPERATION = 0x07
DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
FAULT_RESET = 0x80

# CiA 402, statusword: (mask, value, state). Bit 5 is not allowed in the four states of mask 0x4F.
_TABLE = (
    (0x4F, 0x00, AxisState.NOT_READY),
    (0x4F, 0x40, AxisState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, AxisState.READY_TO_SWITCH_ON),
    (0x6F, 0x23, AxisState.SWITCHED_ON),
    (0x6F, 0x27, AxisState.OPERATION_ENABLED),
    (0x6F, 0x07, AxisState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, AxisState.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, AxisState.FAULT),
)


def _decode(statusword: int) -> AxisState:
    for mask, value, state in _TABLE:
        if statusword & mask == value:
            return state
    return AxisState.NOT_READY


STATE_OF = bytes(_decode(word) for word in range(0x80)) * 0x200  # the masks have seven bits
"""AxisState by statusword. A pattern that CiA 402 does not define reads as NOT_READY: such a drive
is given no torque and is commanded nothing but disable voltage."""


def decode(statusword: int) -> AxisState:
    """State of a statusword, 0 to 0xFFFF."""
    return AxisState(STATE_OF[statusword])


# The next word on the way from a state to a command's goal: one transition at a time.
_WORDS: dict[AxisCommand, dict[AxisState, int]] = {
    AxisCommand.ENABLE: {
        AxisState.SWITCH_ON_DISABLED: SHUTDOWN,  # transition 2
        AxisState.READY_TO_SWITCH_ON: SWITCH_ON,  # 3
        AxisState.SWITCHED_ON: ENABLE_OPERATION,  # 4
        AxisState.OPERATION_ENABLED: ENABLE_OPERATION,
        AxisState.QUICK_STOP_ACTIVE: ENABLE_OPERATION,  # 16
    },
    AxisCommand.DISABLE: {
        AxisState.OPERATION_ENABLED: DISABLE_OPERATION,  # 5
        AxisState.SWITCHED_ON: SHUTDOWN,  # 6
    },
    AxisCommand.QUICK_STOP: {
        AxisState.OPERATION_ENABLED: QUICK_STOP,  # 11
        AxisState.QUICK_STOP_ACTIVE: QUICK_STOP,
        AxisState.SWITCHED_ON: QUICK_STOP,  # 10
        AxisState.READY_TO_SWITCH_ON: QUICK_STOP,  # 7
        AxisState.LOST: QUICK_STOP,
    },
}
# An axis without a fault has nothing to reset; it is left without power like the others.
_WORDS[AxisCommand.RESET_FAULT] = _WORDS[AxisCommand.DISABLE]

_NEXT = np.array(
    [
        [_WORDS[command].get(state, DISABLE_VOLTAGE) for state in AxisState]
        for command in AxisCommand
    ],
    dtype=np.int64,
)
_COMMANDS = len(AxisCommand)
_FAULT = int(AxisState.FAULT)
_LOST = int(AxisState.LOST)
_RESET = int(AxisCommand.RESET_FAULT)
_ENABLE = int(AxisCommand.ENABLE)


@njit("int64(int64, int64, int64)", cache=True)
def controlword(state: int, command: int, last: int) -> int:
    """The word that takes an axis seen in ``state`` one transition towards ``command``; ``last`` is
    the one before, because a fault reset is an edge and not a level.

    In FAULT a reset is sent as 0x00 and then 0x80, over and over, so that a lost frame or a cause
    that is still there costs one more round and no more. A drive that is LOST while it should be
    enabled keeps the word it had: it may still hear us, and a power cycle on its side leaves it in
    Switch On Disabled, where 0x0F does nothing. A number that is no command counts as DISABLE.
    """
    if state == _FAULT and command == _RESET:
        return DISABLE_VOLTAGE if last != DISABLE_VOLTAGE else FAULT_RESET
    if state == _LOST and command == _ENABLE:
        return last & ~FAULT_RESET
    return int(_NEXT[command if command < _COMMANDS else 0, state])
