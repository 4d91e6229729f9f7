"""From the payloads of a ring to blocks of CDR messages, whole chunks at a time."""

from __future__ import annotations

import json
import struct
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.mcap_file import Announces, Block
from tonus.runtime.recording.payloads import EVENT, FRAME, KEYFRAME
from tonus.runtime.recording.ring import Meta, RingError
from tonus.runtime.topics import from_json, record_dtype

FRAME_DEFINITION = """\
std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

EVENT_TOPIC = "/tonus/events"
EVENT_MESSAGE = "tonus_msgs/msg/Event"
EVENT_DEFINITION = """\
uint64 tick  # the tick it belongs to
uint8 level  # 10 debug, 20 info, 30 warning, 40 error, 50 fatal
string name  # what happened
string where  # the axis, cell, bus or part it concerns
string text  # one line to read
"""

KEYFRAME_TOPIC = "/tonus/keyframe"
KEYFRAME_MESSAGE = "tonus_msgs/msg/Keyframe"
KEYFRAME_DEFINITION = """\
uint64 tick  # the state is that after this tick
uint8[] state  # of the control cycle
"""

_EXTENDED, _REMOTE, _ERROR = 1 << 31, 1 << 30, 1 << 29
_IDENTIFIER_BITS = _ERROR - 1


class Encoder(Protocol):
    """Turns the records of one ring into messages."""

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        """From records of UTC in ns (n,), ring positions (n,), payloads (n, payload size)."""
        ...


class RecordEncoder:
    """A record that holds one message of every topic, side by side."""

    def __init__(self, file: Announces, meta: Meta) -> None:
        topics = from_json(meta["topics"])
        self.dtype = record_dtype(topics)
        self._parts: list[tuple[int, slice]] = []
        at = 0
        for topic in topics:
            size = topic.dtype.itemsize
            channel = file.channel(topic.name, topic.message, topic.definition)
            self._parts.append((channel, slice(at, at + size)))
            at += size

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        return [
            Block(channel, log_time, position, payload[:, part]) for channel, part in self._parts
        ]


class FrameEncoder:
    """Raw bus frames, one topic for each bus; frame_id is the bus's name, and sequence counts
    through all buses."""

    def __init__(self, file: Announces, meta: Meta) -> None:
        self._channels: list[tuple[int, NDArray[np.void]]] = []
        for name in meta["channels"]:
            channel = file.channel(f"/can/{name}", "can_msgs/msg/Frame", FRAME_DEFINITION)
            self._channels.append((channel, _frame_template(name)))

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        frames = payload.view(FRAME)[:, 0]
        blocks = []
        for index, (channel, template) in enumerate(self._channels):
            chosen = np.flatnonzero(frames["channel"] == index)
            some, stamps = frames[chosen], log_time[chosen]
            body = np.repeat(template, len(some))
            body["sec"], body["nanosec"] = np.divmod(stamps, 1_000_000_000)
            identifier = some["identifier"]
            body["id"] = identifier & _IDENTIFIER_BITS
            body["is_rtr"] = (identifier & _REMOTE) != 0
            body["is_extended"] = (identifier & _EXTENDED) != 0
            body["is_error"] = (identifier & _ERROR) != 0
            body["dlc"] = some["dlc"]
            body["data"] = some["data"]
            rows = body.view(np.uint8).reshape(len(some), template.itemsize)
            blocks.append(Block(channel, stamps, position[chosen], rows))
        return blocks


class EventEncoder:
    """Events: few, and of any length, so one block each."""

    def __init__(self, file: Announces) -> None:
        self._channel = file.channel(EVENT_TOPIC, EVENT_MESSAGE, EVENT_DEFINITION)

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        blocks = []
        for index, event in enumerate(payload.view(EVENT)[:, 0]):
            body = struct.pack("<QB", int(event["tick"]), int(event["level"]))
            for field in ("name", "where", "text"):
                text = bytes(event[field]) + b"\0"
                body += bytes(-len(body) % 4) + struct.pack("<I", len(text)) + text
            blocks.append(
                Block(
                    self._channel,
                    log_time[index : index + 1],
                    position[index : index + 1],
                    np.frombuffer(body, np.uint8)[None, :],
                )
            )
        return blocks


class KeyframeEncoder:
    """States of the cycle: few, and of any length."""

    def __init__(self, file: Announces) -> None:
        self._channel = file.channel(KEYFRAME_TOPIC, KEYFRAME_MESSAGE, KEYFRAME_DEFINITION)

    def __call__(
        self, log_time: NDArray[np.int64], position: NDArray[np.int64], payload: NDArray[np.uint8]
    ) -> list[Block]:
        blocks = []
        for index, row in enumerate(payload.view(KEYFRAME)[:, 0]):
            size = int(row["size"])
            body = struct.pack("<QI", int(row["tick"]), size) + row["state"][:size].tobytes()
            blocks.append(
                Block(
                    self._channel,
                    log_time[index : index + 1],
                    position[index : index + 1],
                    np.frombuffer(body, np.uint8)[None, :],
                )
            )
        return blocks


def _frame_template(name: str) -> NDArray[np.void]:
    """One can_msgs/msg/Frame body (1,) with what is constant for a bus filled in."""
    frame_id = name.encode() + b"\0"
    dtype = np.dtype(
        [
            ("sec", "<i4"),
            ("nanosec", "<u4"),
            ("frame_id_size", "<u4"),
            ("frame_id", "u1", (len(frame_id),)),
            ("padding", "u1", (-len(frame_id) % 4,)),
            ("id", "<u4"),
            ("is_rtr", "u1"),
            ("is_extended", "u1"),
            ("is_error", "u1"),
            ("dlc", "u1"),
            ("data", "u1", (8,)),
        ]
    )
    template = np.zeros(1, dtype)
    template["frame_id_size"] = len(frame_id)
    template["frame_id"] = np.frombuffer(frame_id, np.uint8)
    return template


def encoder(file: Announces, events: EventEncoder, meta: Meta) -> Encoder:
    """The encoder for a ring's kind; announces its topics in ``file``."""
    kind = meta.get("kind")
    if kind == "record":
        return RecordEncoder(file, meta)
    if kind == "frames":
        return FrameEncoder(file, meta)
    if kind == "events":
        return events
    if kind == "keyframes":
        return KeyframeEncoder(file)
    raise RingError(f"a ring of unknown kind: {json.dumps(meta)[:80]}")
