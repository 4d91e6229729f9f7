"""Every fault the lab's bus can have, as the master sees it: a named event with its place and the
reaction, and no torque on the wire that rests on a measurement older than the freshness."""

from __future__ import annotations

import struct
from typing import Any

import can
import pytest
from hil.can_bench import CONFIG, PERIOD_S, Bench, enabled, on_lab
from wired import CHANNEL

from tonus.config.schema.faults import FAULT
from tonus.drivers.events import EVENTS
from tonus.drivers.process_image import AxisState

LIMIT_S = (CONFIG.control.freshness.measurement_ticks + 2) * PERIOD_S
"""between two ends on the wire: the measurement's age, the tick in which it was made, and the way
of the torque"""
TICKS = 400
ELSEWHERE = [axis for axis in range(CONFIG.robot.cables) if CHANNEL[axis + 1] != "can0"]


def inject(bench: Bench, kind: str, fields: dict[str, Any]) -> None:
    bench.lab.inject(FAULT.validate_python({"kind": kind, "channel": "can0", **fields}))


class Witness:
    """A bus of its own on can0: what was on the wire, and when."""

    def __init__(self) -> None:
        self._bus = can.Bus(interface="tonus", channel="can0")
        self._measured: dict[int, float] = {}
        self.torques = 0

    def look(self) -> None:
        """No torque since the last look came long after its axis was last heard."""
        while (message := self._bus.recv(0)) is not None:
            number, stamp = message.arbitration_id, message.timestamp
            if message.is_error_frame:
                continue
            if number in (0x181, 0x187) and message.dlc == 8:
                self._measured[number] = stamp
            elif number - 0x80 in self._measured:
                _, torque = struct.unpack("<Hh", message.data)
                if torque:
                    self.torques += 1
                    assert stamp - self._measured[number - 0x80] <= LIMIT_S

    def close(self) -> None:
        self._bus.shutdown()


def told(bench: Bench) -> set[tuple[str, str]]:
    """Names and places of the events since the last call, each with its reaction in its words."""
    found = set()
    for event in bench.fieldbus.take_events():
        assert event.text.endswith(EVENTS[event.name].reaction)
        found.add((event.name, event.where))
    return found


@pytest.mark.parametrize(
    ("kind", "fields", "wanted"),
    [
        ("loss", {"identifier": 0x181, "frames": 1}, {("missing_pdo", "can0/1")}),
        ("loss", {"identifier": 0x181, "frames": 30}, {("silent_pdo", "can0/1")}),
        ("delay", {"identifier": 0x181, "frames": 1, "delay_us": 1500}, {("late_pdo", "can0/1")}),
        ("duplicate", {"identifier": 0x187, "frames": 1}, {("duplicate_pdo", "can0/7")}),
        ("corruption", {"identifier": 0x187, "frames": 1}, {("bus_error", "can0")}),
        ("babble", {"duration": 0.1}, {("bus_flooded", "can0"), ("bus_stalled", "can0")}),
        ("babble", {"identifier": 0x7FF, "duration": 0.1}, {("foreign_frame", "can0/0x7FF")}),
        ("stuck", {"duration": 0.003}, {("bus_passive", "can0")}),
        ("stuck", {"duration": 0.05}, {("bus_passive", "can0"), ("bus_stalled", "can0")}),
        ("disconnect", {"duration": 0.05}, {("bus_passive", "can0"), ("bus_stalled", "can0")}),
        ("unplug", {"node": 7}, {("heartbeat_lost", "can0/7")}),
        ("power_cycle", {"node": 7}, {("boot_up", "can0/7")}),
    ],
)
def test_a_fault_is_a_named_event_and_no_torque_rests_on_an_old_measurement(
    kind: str, fields: dict[str, Any], wanted: set[tuple[str, str]]
) -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.image.commands["torque"] = 0.5
        await bench.ticks(5)
        witness = Witness()
        try:
            await bench.ticks(15)
            witness.look()
            assert witness.torques > 20
            assert told(bench) == set()
            inject(bench, kind, fields)
            seen = set()
            for _ in range(TICKS):
                await bench.ticks(1)
                witness.look()
                seen |= told(bench)
        finally:
            witness.close()
        assert wanted <= seen, seen
        # What happens on one channel stays there.
        assert {where.split("/")[0] for _, where in seen} == {"can0"}
        assert (bench.image.axes["state"][ELSEWHERE] == AxisState.OPERATION_ENABLED).all()

    on_lab(script)
