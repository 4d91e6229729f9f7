"""Compiled code books and takes apart exactly what Python would have, whatever comes."""

from __future__ import annotations

import asyncio

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.fake_can import DRIVE_TPDO, Robot, in_virtual_time

KINDS = ("regular", "twice", "copy", "lost", "short", "heartbeat", "remote", "own", "foreign")
ticks = st.lists(
    st.lists(
        st.tuples(
            st.integers(0, 7),
            st.sampled_from(KINDS),
            st.integers(-(1 << 31), (1 << 31) - 1),
            st.sampled_from([0.0, 0.0, 0.4e-3, 1.5e-3]),
        ),
        max_size=24,
    ),
    max_size=30,
)


async def played(script: list[list[tuple[int, str, int, float]]], *, stamped: bool, compiled: bool):
    """Everything that came of it, tick by tick."""
    robot = Robot()
    await robot.start()
    fieldbus, loop = robot.fieldbus, asyncio.get_running_loop()
    if not compiled:
        fieldbus._together._reception = lambda frames, at, now_ns: at
    seen = []
    for tick, frames in enumerate([[], *script]):
        for axis, kind, position, age in frames:
            bus, node = robot.axis_at[axis]
            stamp = {"timestamp": loop.time() - age} if stamped else {}
            data = DRIVE_TPDO.pack(0x1637, position, position % 1000 - 500)
            if kind == "heartbeat":
                bus.put(0x700 + node, b"\x05", **stamp)
            elif kind == "foreign":
                bus.put(0x7A0, data, **stamp)
            elif kind != "lost":
                data = data[:7] if kind == "short" else data
                flags = {"is_rx": kind != "own", "is_remote_frame": kind == "remote"}
                bus.put(0x180 + node, b"" if kind == "remote" else data, **flags, **stamp)
            if kind in ("twice", "copy"):
                again = data if kind == "copy" else DRIVE_TPDO.pack(0x1637, position // 2, 0)
                bus.put(0x180 + node, again, **stamp)
        fieldbus.collect(tick)
        exchange = fieldbus._exchange
        events = [(event.name, event.where, event.text) for event in fieldbus.take_events()]
        stamps = [channel.syncs.answered_ns for channel in fieldbus._buses]
        seen.append((exchange.integers.tolist(), events, stamps, robot.image.axes.tobytes()))
        await asyncio.sleep(0.001)
    await fieldbus.stop()
    return seen


@settings(max_examples=20, derandomize=True, deadline=None)
@given(ticks, st.booleans())
def test_compiled_code_and_handlers_agree(
    script: list[list[tuple[int, str, int, float]]], stamped: bool
) -> None:
    fast = in_virtual_time(played(script, stamped=stamped, compiled=True))
    slow = in_virtual_time(played(script, stamped=stamped, compiled=False))
    assert fast == slow


def test_a_regular_answer_never_reaches_a_handler() -> None:
    async def work() -> int:
        robot = Robot()
        await robot.start()
        robot.fieldbus.collect(0)
        await asyncio.sleep(0.001)
        called = 0

        def count(_: bytes) -> None:
            nonlocal called
            called += 1

        for channel in robot.fieldbus._buses:
            for identifier in channel.handlers:
                channel.handlers[identifier] = count
        robot.put_all()
        robot.fieldbus.collect(1)
        assert set(robot.image.axes["age"].tolist() + robot.image.cells["age"].tolist()) == {0}
        before = called
        await robot.fieldbus.stop()
        return before

    assert in_virtual_time(work()) == 0
