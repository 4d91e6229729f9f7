"""The lab's door, in virtual time: what it is asked, does and refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_bench import Bench

from tonus.config.faults import KINDS
from tonus.sim.devices.cia402.states import State
from tonus.sim.lab.door import REQUEST_BYTES, Door

DRIVES = ["can0/1", "can0/7", "can1/3", "can1/5", "can2/4", "can2/6", "can3/2", "can3/8"]


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as bench:
        bench.wait(10)
        yield bench


@pytest.fixture
def door(bench: Bench) -> Door:
    return Door(bench.lab)


def fault(kind: str, **fields: object) -> dict[str, Any]:
    return {"op": "inject", "fault": {"kind": kind, **fields}}


def node(reply: dict[str, Any], channel: str, number: int) -> dict[str, Any]:
    (found,) = (n for n in reply["nodes"] if (n["channel"], n["node"]) == (channel, number))
    return dict(found)


def test_a_ping_tells_the_labs_time(bench: Bench, door: Door) -> None:
    bench.wait(240)
    assert door.request({"op": "ping"}) == {"ok": True, "time": 0.25}


def test_a_node_that_is_unplugged_is_not_heard_until_it_is_put_back(
    bench: Bench, door: Door
) -> None:
    place = {"channel": "can1", "node": 3}
    assert door.request(fault("unplug", **place)) == {"ok": True, "time": 0.01, "at": 0.01}
    assert not node(door.request({"op": "get"}), "can1", 3)["plugged"]
    bench.read("can1")
    bench.send("can1", 0x000, b"\x82\x00")
    bench.wait(5)
    assert {m.arbitration_id for m in bench.read("can1")} == {0x705, 0x713, 0x715}
    assert door.request(fault("replug", **place))["ok"]
    bench.send("can1", 0x000, b"\x82\x00")
    bench.wait(5)
    assert 0x703 in {m.arbitration_id for m in bench.read("can1")}


def test_a_fault_happens_so_long_from_now_as_it_says(bench: Bench, door: Door) -> None:
    request = fault("drive_error", channel="can0", node=1, code=0x2310, at=0.5)
    assert door.request(request) == {"ok": True, "time": 0.01, "at": 0.51}
    bench.wait(499)
    assert bench.lab.drives[0].state is not State.FAULT
    bench.wait(2)
    told = node(door.request({"op": "get"}), "can0", 1)
    assert (told["state"], told["error"]) == ("FAULT", 0x2310)


def test_the_lab_tells_its_channels_nodes_and_seed(door: Door) -> None:
    told = door.request({"op": "get"})
    assert told["ok"]
    assert told["seed"] == 1
    assert list(told["channels"]) == ["can0", "can1", "can2", "can3"]
    assert len(told["nodes"]) == 17
    drive, cell = node(told, "can2", 6), node(told, "can3", 25)
    assert (drive["device"], drive["nmt"]) == ("axis 5", "PRE_OPERATIONAL")
    assert (drive["state"], drive["error"]) == ("SWITCH_ON_DISABLED", 0)
    assert cell["device"] == "cell 8"
    assert told["faults"] == []
    json.dumps(told, allow_nan=False)


def test_the_kinds_are_those_of_the_schema_with_where_they_can_happen(door: Door) -> None:
    kinds = door.request({"op": "kinds"})["kinds"]
    assert list(kinds) == list(KINDS)
    code = kinds["drive_error"]["fields"]["code"]
    assert (code["required"], code["low"], code["high"]) == (True, 1, 0xFFFF)
    assert kinds["drive_error"]["where"] == DRIVES
    assert "can3/25" in kinds["cell_break"]["where"]
    assert len(kinds["unplug"]["where"]) == 17
    assert kinds["loss"]["where"] == ["can0", "can1", "can2", "can3"]


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ([], "a request is a JSON object"),
        ({}, "op is missing; choose one of inject, clear, get, kinds, ping"),
        ({"op": "explode"}, "there is no op 'explode'"),
        ({"op": ["ping"]}, "there is no op"),
        ({"op": "ping", "loud": True}, "loud is not a field here; remove it"),
        ({"op": "inject"}, "fault is missing; add it"),
        ({"op": "inject", "fault": {}}, "fault has no kind; choose one of unplug"),
        (fault("nope"), "there is no kind 'nope'; choose one of unplug"),
        (fault("unplug", channel="can0"), "fault.node is missing; add it"),
        (fault("unplug", channel="can0", nod=1), "fault.nod is not a field here; unplug has"),
        (fault("unplug", channel="can0", node=128), "fault.node: input should be less than or"),
        (fault("unplug", channel="can0", node=True), "fault.node: must be a number, not true"),
        (fault("unplug", channel="can9", node=1), "'can9'"),
        (fault("unplug", channel="can0", node=1, at=1e300), "fault.at: input should be less"),
        (fault("unplug", channel="can0", node=1, at=float("nan")), "fault.at: input should be"),
        (fault("drive_error", channel="can0", node=17, code=0x2310), "is not a drive"),
        (fault("drive_error", channel="can0", node=1, code=0x1234), "has no error 0x1234"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line_and_changes_nothing(
    request_: object, words: str, door: Door
) -> None:
    before = door.request({"op": "get"})
    reply = door.request(request_)
    assert set(reply) == {"ok", "error"}
    assert not reply["ok"]
    assert words in reply["error"]
    assert "\n" not in reply["error"]
    assert door.request({"op": "get"}) == before


@pytest.mark.parametrize(
    ("datagram", "words"),
    [
        (b"", "is not JSON"),
        (b"{", "is not JSON"),
        (b"\xff", "is not UTF-8"),
        (b"[" * REQUEST_BYTES, "is not JSON"),
        (b"9" * 5000, "is not JSON"),
        (b"17", "is a JSON object, not 17"),
        (b'{"op":"ping"}' + b" " * REQUEST_BYTES, "longer than 65536 bytes"),
    ],
)
def test_bytes_that_are_no_request_get_a_line_too(datagram: bytes, words: str, door: Door) -> None:
    reply = json.loads(door.answer(datagram))
    assert not reply["ok"]
    assert words in reply["error"]


_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=5,
)
_fields = st.fixed_dictionaries(
    {"kind": st.sampled_from([*KINDS, "nope"])},
    optional={
        "at": st.floats() | st.integers() | st.booleans(),
        "channel": st.sampled_from(["can0", "can3", "can9"]) | _values,
        "node": st.sampled_from([1, 17, 25]) | _values,
        "code": st.integers(-1, 0x10000) | _values,
        "identifier": st.integers(-1, 0x800) | _values,
        "probability": st.floats(),
        "frames": st.integers(),
        "duration": st.floats(),
        "delay_us": st.integers(),
        "input": st.sampled_from(["sto", "home", "nope"]),
        "broken": _values,
        "active": _values,
    },
)
_requests = (
    st.fixed_dictionaries({"op": st.just("inject"), "fault": _fields})
    | st.dictionaries(st.sampled_from(["op", "fault", "channel"]), _values)
    | st.fixed_dictionaries(
        {"op": st.sampled_from(["inject", "clear", "get"])},
        optional={"channel": _values, "fault": _values},
    )
)


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.lists(_requests | _values, min_size=10, max_size=30))
def test_no_request_brings_the_lab_down(requests: list[object]) -> None:
    with Bench() as bench:
        door = Door(bench.lab)
        for request in requests:
            reply = json.loads(door.answer(json.dumps(request).encode()))
            assert reply["ok"] or "\n" not in reply["error"]
            bench.wait(1)
        assert door.request({"op": "ping"})["ok"]
