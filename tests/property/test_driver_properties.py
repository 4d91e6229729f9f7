"""Whatever arrives and whatever is commanded, nothing wild reaches a bus or the image."""

from __future__ import annotations

import math
import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tonus.config import load
from tonus.drivers.canopen.emcy import parse as parse_emcy
from tonus.drivers.canopen.nmt import NodeMonitor
from tonus.drivers.devices.tracker import DATAGRAM, TrackerInput
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisState, ProcessImage

CONFIG = load("config/can.yaml")[0]
RATED = CONFIG.robot.motor.rated_torque * CONFIG.robot.gearbox.ratio
eight = {"min_size": 8, "max_size": 8}
any_float = st.floats(allow_nan=True, allow_infinity=True)


def exchange() -> tuple[Exchange, ProcessImage]:
    image = ProcessImage(8)
    places = [f"axis {axis}" for axis in range(8)]
    cell, freshness = CONFIG.fieldbus.force_cell, CONFIG.control.freshness
    return Exchange(CONFIG.robot, cell, freshness, image, EventLog(), places), image


@given(
    torques=st.lists(any_float, **eight),
    commands=st.lists(st.integers(0, 255), **eight),
    statuswords=st.lists(st.integers(0, 0xFFFF), **eight),
    ages=st.lists(st.integers(0, 6), **eight),
)
def test_only_a_finite_limited_torque_for_an_enabled_axis_reaches_a_bus(
    torques: list[float], commands: list[int], statuswords: list[int], ages: list[int]
) -> None:
    made, image = exchange()
    made.statuswords[:] = statuswords
    made.axis_tick[:] = [99 - age for age in ages]
    made.fill(100)
    image.commands["torque"] = torques
    image.commands["command"] = commands
    words, mille = made.commands()
    for axis in range(8):
        struct.pack("<Hh", words[axis], mille[axis])
        assert abs(mille[axis]) <= 2000
        if not math.isfinite(torques[axis]):
            assert mille[axis] == 0
        if mille[axis]:
            assert image.axes["state"][axis] == AxisState.OPERATION_ENABLED
            assert commands[axis] == 1
            assert ages[axis] <= CONFIG.control.freshness.measurement_ticks


@given(st.lists(st.integers(-2000, 2000), **eight))
def test_per_mille_survive_the_way_to_newton_metres_and_back(mille: list[int]) -> None:
    made, image = exchange()
    made.statuswords[:] = [0x1637] * 8
    made.torques[:] = mille
    made.axis_tick[:] = [99] * 8
    made.fill(100)
    assert np.allclose(image.axes["torque"], np.array(mille) * RATED / 1000, rtol=1e-12, atol=0)
    image.commands["torque"] = image.axes["torque"]
    image.commands["command"] = 1
    assert made.commands()[1] == mille


@given(st.lists(st.integers(-(2**31), 2**31 - 1), **eight))
def test_increments_become_angles_without_loss(positions: list[int]) -> None:
    made, image = exchange()
    made.positions[:] = positions
    made.fill(0)
    back = image.axes["angle"] / (2 * math.pi) * 4096 * 49 / 4
    assert np.rint(back).astype(np.int64).tolist() == positions


class Given:
    def __init__(self, datagrams: list[bytes]) -> None:
        self.datagrams = datagrams

    def poll(self, now_ns: int) -> list[bytes]:
        return self.datagrams

    def close(self) -> None: ...


pose = st.builds(
    DATAGRAM.pack,
    st.sampled_from([b"TNTK", b"TNTK", b"\0\0\0\0"]),
    st.integers(0, 2),
    st.integers(0, 1),
    st.integers(0, 2**32 - 1),
    st.integers(0, 3),
    st.integers(-(2**63), 2**63 - 1),
    *[any_float] * 3,
    *[st.one_of(st.sampled_from([0.0, 1.0, -1.0]), any_float)] * 4,
    st.floats(width=32),
)


@given(st.lists(st.one_of(st.binary(max_size=200), pose), max_size=6), st.integers(0, 2**62))
def test_no_datagram_puts_anything_wild_into_the_image(datagrams: list[bytes], now: int) -> None:
    image = ProcessImage(8)
    tracker = TrackerInput(image, Given(datagrams))
    tracker.collect(now)
    row = image.tracker
    assert np.isfinite(row["position"]).all()
    assert abs(np.linalg.norm(row["quaternion"]) - 1.0) < 2e-3
    assert row["delay"] >= 0.0
    assert row["fresh"] in (0, 1)
    assert tracker.malformed <= len(datagrams)


@given(st.binary(max_size=8))
def test_heartbeats_and_emergencies_of_any_content_are_survived(data: bytes) -> None:
    NodeMonitor().receive(data)
    parsed = parse_emcy(data)
    assert (parsed is None) == (len(data) < 3)
