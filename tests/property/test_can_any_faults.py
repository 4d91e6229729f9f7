"""Any faults in any order: the lab stands, steps of time change nothing, and clearing ends all."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import Any

import can
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_bench import Bench

from tonus.config.schema.faults import FAULT
from tonus.sim.can.wire.confinement import ErrorState

TICKS = 30
_OF_FRAMES = {
    "identifier": st.none() | st.sampled_from([0x080, 0x181, 0x191, 0x201, 0x601]),
    "probability": st.sampled_from([0.05, 0.5, 1.0]),
    "frames": st.none() | st.integers(1, 20),
    "duration": st.none() | st.sampled_from([0.001, 0.01]),
}
_NODE = {"node": st.sampled_from([1, 7, 17])}
_DURATION = {"duration": st.none() | st.sampled_from([0.0005, 0.01])}
_FIELDS: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "loss": _OF_FRAMES,
    "corruption": _OF_FRAMES,
    "delay": {**_OF_FRAMES, "delay_us": st.sampled_from([10, 1000, 7000])},
    "duplicate": _OF_FRAMES,
    "babble": {
        **_DURATION,
        "identifier": st.sampled_from([0x000, 0x100, 0x7FF]),
        "period_us": st.sampled_from([1, 300]),
    },
    "stuck": {**_DURATION, "level": st.sampled_from(["dominant", "recessive"])},
    "disconnect": _DURATION,
    "unplug": _NODE,
    "replug": _NODE,
    "clear": {},
}
_FAULT = st.sampled_from(sorted(_FIELDS)).flatmap(
    lambda kind: st.fixed_dictionaries(
        {"kind": st.just(kind), "channel": st.just("can0"), **_FIELDS[kind]}
    )
)
_PLAN = st.lists(st.tuples(st.integers(0, TICKS * 1000 - 1), _FAULT), min_size=1, max_size=8)


def play(plan: list[tuple[int, dict[str, Any]]], step_us: int) -> list[bytes]:
    """Everything heard on the disturbed channel and the next; ends with the lab put right."""
    with Bench() as bench:
        bench.configure_all()
        bench.enable()
        begin = bench.now
        for at_us, fields in plan:
            bench.lab.inject(FAULT.validate_python({**fields, "at": max(at_us, 1) * 1e-6}))
        for _ in range(TICKS):
            for name in ("can0", "can1"):
                for identifier in (0x080, 0x77F):
                    with suppress(can.CanOperationError):  # a full queue
                        bench.send(name, identifier, b"\5" if identifier == 0x77F else b"")
            for _ in range(1000 // step_us):
                bench.wait(step_us * 1e-3)
        assert bench.now - begin == TICKS * 1_000_000
        heard = [
            struct.pack("<dI", m.timestamp, m.arbitration_id) + bytes(m.data)
            for name in ("can0", "can1")
            for m in bench.read(name)
        ]
        bench.lab.inject(FAULT.validate_python({"kind": "clear"}))
        assert bench.lab.faults() == []
        bench.wait(200)
        for controller in bench.lab.statistics()["channels"]["can0"]["controllers"].values():
            assert controller["connected"]
            assert controller["state"] != ErrorState.OFF.value
            assert controller["queued"] == 0, "what waited has gone out"
        bench.send("can0", 0x000, b"\x81\x00")
        bench.wait(50)
        for node, kind in ((1, 0x20192), (7, 0x20192), (17, 0x20194), (23, 0x20194)):
            assert bench.upload("can0", node, 0x1000, 0) == struct.pack("<I", kind), "it answers"
        return heard


@settings(max_examples=15, deadline=None, derandomize=True)
@given(_PLAN)
def test_any_faults_leave_a_lab_that_can_be_put_right(
    plan: list[tuple[int, dict[str, Any]]],
) -> None:
    assert play(plan, 1000) == play(plan, 100)
