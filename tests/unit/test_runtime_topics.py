"""A topic's packed numpy layout is the CDR body of its message definition, byte for byte."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest

from tonus.runtime.signals import CycleRecord, cycle_dtype, topics
from tonus.runtime.topics import Field, Topic, from_json, record_dtype, to_json

CYCLE, TOPICS = cycle_dtype(8), topics(8)

CDR = {
    "float64": ("d", 8),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float32": ("f", 4),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int8": ("b", 1),
    "uint8": ("B", 1),
}
LINE = re.compile(r"^(\w+?)(?:\[(\d+)\])? (\w+)  # .+$")


def encode(definition: str, values: dict[str, np.ndarray]) -> bytes:
    """CDR body from the message definition alone: each member aligned to its own width."""
    body = b""
    for line in definition.splitlines():
        match = LINE.match(line)
        assert match, line
        kind, size, name = match.groups()
        code, width = CDR[kind]
        body += b"\0" * (-len(body) % width)
        members = np.ravel(values[name])
        assert len(members) == int(size or 1)
        body += struct.pack(f"<{len(members)}{code}", *members.tolist())
    return body


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.message)
def test_the_record_is_the_message(topic: Topic) -> None:
    record = np.zeros(1, topic.dtype)
    random = np.random.default_rng(len(topic.fields))
    record.view("u1")[:] = random.integers(0, 128, record.nbytes)
    values = {name: record[name][0] for name in topic.dtype.names or ()}
    assert encode(topic.definition, values) == record.tobytes()


def test_names_are_unique_and_the_cycle_record_has_no_padding() -> None:
    assert len({topic.name for topic in TOPICS}) == len({topic.message for topic in TOPICS})
    assert len({topic.message for topic in TOPICS}) == len(TOPICS)
    assert CYCLE.itemsize == sum(topic.dtype.itemsize for topic in TOPICS)
    assert record_dtype(TOPICS) == CYCLE


def test_fields_must_stand_widest_first() -> None:
    small, wide = Field("a", "uint8", 0, "", "x"), Field("b", "float64", 0, "", "x")
    Topic("/t/t", "t/msg/T", "x", (wide, small))
    with pytest.raises(ValueError, match="widest first"):
        Topic("/t/t", "t/msg/T", "x", (small, wide))


def test_topics_survive_json() -> None:
    assert from_json(to_json(TOPICS)) == TOPICS
    assert to_json(from_json(to_json(TOPICS))) == to_json(TOPICS)


def test_views_write_through_to_the_record() -> None:
    record = CycleRecord(8)
    record.pose.position[:] = (1.0, 2.0, 3.0)
    record.timing.tick[...] = 7
    record.stiffness.k_eq[...] = 3210.0
    np.testing.assert_array_equal(record.data["pose"]["position"][0], (1.0, 2.0, 3.0))
    assert record.data["timing"]["tick"][0] == 7
    assert record.data["stiffness"]["k_eq"][0] == 3210.0
    assert np.count_nonzero(record.data.view("u1")) > 0
