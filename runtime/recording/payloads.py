"""What the rings hold beside cycle records: raw bus frames, events for people, keyframes."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

FRAME = np.dtype(
    [
        ("identifier", "<u4"),  # bit 31 extended, 30 remote, 29 error
        ("channel", "u1"),  # index into the ring's meta "channels"
        ("dlc", "u1"),
        ("flags", "u1"),  # SENT
        ("padding", "u1"),
        ("data", "u1", (8,)),
    ]
)
SENT = 1
"""flag of a frame that we sent"""

EVENT = np.dtype(
    [
        ("tick", "<u8"),
        ("level", "u1"),  # Level
        ("name", "S32"),
        ("where", "S32"),
        ("text", "S439"),
    ]
)

KEYFRAME_BYTES = 1 << 18
KEYFRAME = np.dtype([("tick", "<u8"), ("size", "<u8"), ("state", "u1", (KEYFRAME_BYTES,))])


class Level(IntEnum):
    """As in rcl_interfaces/msg/Log."""

    DEBUG = 10
    INFO = 20
    WARNING = 30
    ERROR = 40
    FATAL = 50
