"""Device integers to the image and back by themselves: ages, states, scales, limits, places."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.devices.cia402 import DISABLE_VOLTAGE, ENABLE_OPERATION
from tonus.drivers.devices.drive import Scale
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import AXIS, CELL, NOT_YET, UNTRUSTED, Exchange
from tonus.drivers.process_image import NEVER, AxisCommand, AxisState, ProcessImage

CONFIG = load("config/unlike_axes.yaml")[0]
ROBOT, FRESHNESS = CONFIG.robot, CONFIG.control.freshness
CELLS_SCALE = load("config/can.yaml")[0].fieldbus.force_cell
N, CELLS, FRESH = ROBOT.cables, ROBOT.cells, FRESHNESS.measurement_ticks
ENABLED = 0x0237
SCALES = [
    Scale.of(train, sign) for train, sign in zip(ROBOT.drive_trains, ROBOT.signs, strict=True)
]


class Bus:
    def __init__(self) -> None:
        self.image, self.events = ProcessImage(N), EventLog()
        places = [f"can1/{axis + 1}" for axis in range(N)]
        self.exchange = Exchange(ROBOT, CELLS_SCALE, FRESHNESS, self.image, self.events, places)

    def enable(self, tick: int = 10) -> Bus:
        """Samples of the tick before, of enabled drives that are meant to be."""
        self.exchange.axis_tick[:] = self.exchange.cell_tick[:] = tick - 1
        self.exchange.statuswords[:] = ENABLED
        self.image.commands["command"] = AxisCommand.ENABLE
        self.exchange.fill(tick)
        return self

    def torques(self, newton_metre: float) -> list[int]:
        self.image.commands["torque"] = newton_metre
        return self.exchange.commands()[1]

    def told(self) -> list[tuple[str, str]]:
        return [(event.name, event.where) for event in self.events.take()]


@pytest.fixture
def bus() -> Bus:
    return Bus()


def test_before_the_first_sample_nothing_is_known(bus: Bus) -> None:
    bus.exchange.fill(0)
    assert (bus.image.axes["age"] == NEVER).all()
    assert (bus.image.cells["age"] == NEVER).all()
    assert (bus.image.axes["state"] == AxisState.LOST).all()


@pytest.mark.parametrize(
    ("tick", "age"),
    [(9, 0), (8, 1), (9 - FRESH, FRESH), (10, NEVER), (9 - NEVER, NEVER), (10 - NEVER, NEVER - 1)],
)
def test_how_old_a_sample_is(bus: Bus, tick: int, age: int) -> None:
    """One of the last tick is as fresh as can be; one of a tick yet to come is none."""
    bus.exchange.axis_tick[2] = bus.exchange.cell_tick[3] = tick
    bus.exchange.statuswords[:] = ENABLED
    bus.exchange.fill(10)
    lost = AxisState.LOST if age > FRESH else AxisState.OPERATION_ENABLED
    assert bus.image.axes["state"][2] == lost
    assert bus.image.axes["age"][2] == age
    assert bus.image.cells["age"][3] == age
    assert bus.image.axes["age"][1] == bus.image.cells["age"][2] == NEVER


def test_a_drive_is_lost_once_its_sample_is_too_old_or_it_is_not_trusted(bus: Bus) -> None:
    bus.enable()
    bus.exchange.axis_tick[1], bus.exchange.axis_tick[2] = 9 - FRESH, 8 - FRESH
    bus.exchange.untrusted[4] = 1
    bus.exchange.fill(10)
    wanted = [
        AxisState.LOST if axis in (2, 4) else AxisState.OPERATION_ENABLED for axis in range(N)
    ]
    assert bus.image.axes["state"].tolist() == wanted


def test_each_value_in_its_own_unit(bus: Bus) -> None:
    exchange, image = bus.exchange, bus.image
    exchange.positions[:] = 1000 + np.arange(N)
    exchange.torques[:] = 100 + np.arange(N)
    exchange.error_codes[:] = 7 + np.arange(N)
    exchange.sampled_ns[:] = 11 + np.arange(N)
    exchange.doubt_ns[:] = 13 + np.arange(N)
    exchange.cells[:] = 1234.0 + np.arange(CELLS)
    bus.enable()
    for axis, scale in enumerate(SCALES):
        row = image.axes[axis]
        assert row["angle"] == pytest.approx((1000 + axis) * scale.radian_per_increment)
        assert row["torque"] == pytest.approx((100 + axis) * scale.newton_metre_per_mille)
        assert (row["error_code"], row["sampled_ns"]) == (7 + axis, 11 + axis)
        assert (row["doubt_ns"], row["statusword"]) == (13 + axis, ENABLED)
    force = (1234.0 + np.arange(CELLS)) / 10.0**CELLS_SCALE.decimal_digits
    assert image.cells["force"] == pytest.approx(force)


def test_a_cells_emergency_is_beyond_what_its_status_says(bus: Bus) -> None:
    bus.exchange.cell_status[[1, 2]] = 3
    bus.exchange.cell_emergency[[2, 4]] = 0x5010
    bus.enable()
    wanted = [{1: 3, 2: UNTRUSTED, 4: UNTRUSTED}.get(cell, 0) for cell in range(CELLS)]
    assert bus.image.cells["status"].tolist() == wanted


def test_a_torque_is_scaled_and_bounded_for_each_axis(bus: Bus) -> None:
    bus.enable()
    for wanted in (1.0, -1.0):
        scaled = [round(wanted * scale.mille_per_newton_metre) for scale in SCALES]
        assert bus.torques(wanted) == scaled
    assert bus.exchange.commands()[0] == [ENABLE_OPERATION] * N
    for wanted in (1e300, -1e300):
        most = [math.copysign(1, scale.mille_per_newton_metre * wanted) for scale in SCALES]
        limits = [int(sign) * scale.mille_limit for sign, scale in zip(most, SCALES, strict=True)]
        assert bus.torques(wanted) == limits


@pytest.mark.parametrize("command", [each for each in AxisCommand if each != AxisCommand.ENABLE])
def test_a_torque_goes_only_to_an_axis_that_is_meant_to_be_enabled(
    bus: Bus, command: AxisCommand
) -> None:
    bus.enable()
    bus.image.commands["command"][3] = command
    assert [torque != 0 for torque in bus.torques(5.0)] == [axis != 3 for axis in range(N)]


@pytest.mark.parametrize(
    "state", [each for each in AxisState if each != AxisState.OPERATION_ENABLED]
)
def test_and_only_to_one_that_is(bus: Bus, state: AxisState) -> None:
    bus.enable()
    bus.image.axes["state"][3] = state
    assert [torque != 0 for torque in bus.torques(5.0)] == [axis != 3 for axis in range(N)]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_torque_that_is_no_number_is_none_and_is_told_once(bus: Bus, value: float) -> None:
    bus.enable()
    good = bus.torques(5.0)
    assert bus.told() == []
    for _ in range(3):
        bus.image.commands["torque"][[2, 5]] = value
        assert bus.exchange.commands()[1] == [0 if k in (2, 5) else good[k] for k in range(N)]
    assert bus.told() == [("non_finite_torque", "can1/3"), ("non_finite_torque", "can1/6")]
    bus.image.commands["torque"][2] = 5.0
    bus.exchange.commands()
    bus.image.commands["torque"][2] = value
    bus.exchange.commands()
    assert bus.told() == [("non_finite_torque", "can1/3")], "its own episode was over"
    assert bus.torques(5.0) == good
    assert bus.told() == []
    for _ in range(2):
        bus.image.commands["torque"][5] = value
        bus.exchange.commands()
    (event,) = bus.events.take()
    assert (event.name, event.where) == ("non_finite_torque", "can1/6")
    assert "axis 5 was commanded a torque that is no number; it gets 0" in event.text


def test_a_controlword_goes_on_from_the_one_before(bus: Bus) -> None:
    """Of each axis: a reset is an edge."""
    bus.enable()
    bus.image.axes["state"][1] = AxisState.FAULT
    bus.image.commands["command"][1] = AxisCommand.RESET_FAULT
    words = [bus.exchange.commands()[0] for _ in range(4)]
    assert [word[1] for word in words] == [0x80, DISABLE_VOLTAGE, 0x80, DISABLE_VOLTAGE]
    assert all(word[0] == ENABLE_OPERATION for word in words)


def test_beginning_anew_is_no_edge_of_a_reset(bus: Bus) -> None:
    bus.enable()
    for axis in (0, N - 2):
        bus.image.axes["state"][axis] = AxisState.FAULT
        bus.image.commands["command"][axis] = AxisCommand.RESET_FAULT
    assert bus.exchange.commands()[0][0] == 0x80
    bus.exchange.forget()
    bus.image.axes["state"] = AxisState.FAULT
    words = bus.exchange.commands()[0]
    assert (words[0], words[N - 2]) == (DISABLE_VOLTAGE, DISABLE_VOLTAGE)


def test_what_a_drive_counts_in_is_taken_over(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the axis that was asked, with its own train and sign."""
    asked = []

    async def read(*given: object) -> Scale:
        asked.append(given)
        return Scale(0.5, 0.25, 4.0, 100)

    monkeypatch.setattr("tonus.drivers.exchange.read_scale", read)
    asyncio.run(bus.exchange.read_scale(3, "access", "profile"))  # type: ignore[arg-type]
    assert asked == [("access", "profile", ROBOT.drive_trains[3], ROBOT.signs[3])]
    bus.exchange.positions[:] = 8
    bus.exchange.torques[:] = 8
    bus.enable()
    assert (bus.image.axes["angle"][3], bus.image.axes["torque"][3]) == (4.0, 2.0)
    assert bus.image.axes["angle"][2] == pytest.approx(8 * SCALES[2].radian_per_increment)
    assert (bus.torques(2.0)[3], bus.torques(1e9)[3]) == (8, 100)


def test_beginning_anew_forgets_all_but_the_scales(bus: Bus) -> None:
    exchange = bus.exchange
    bus.enable()
    for column in (
        exchange.untrusted,
        exchange.sampled_ns,
        exchange.doubt_ns,
        exchange.error_codes,
        exchange.cell_status,
        exchange.cell_emergency,
    ):
        column[:] = 5
    exchange.forget()
    for table, name in (
        (bus.image.axes, "sampled_ns"),
        (bus.image.axes, "doubt_ns"),
        (bus.image.axes, "error_code"),
        (bus.image.cells, "status"),
    ):
        assert not table[name].any()
    assert (bus.image.axes["age"] == NEVER).all()
    assert (exchange.axis_tick == NOT_YET).all()
    assert (exchange.cell_tick == NOT_YET).all()
    assert not exchange.untrusted.any()
    bus.enable()
    assert (bus.image.axes["state"] == AxisState.OPERATION_ENABLED).all()
    assert all(bus.torques(5.0))


def test_each_entry_has_its_place_among_the_words(bus: Bus) -> None:
    """Written there it is read in its column, and no other: for who knows places only."""
    exchange = bus.exchange
    columns = [
        (exchange.axis_tick, N),
        (exchange.positions, N),
        (exchange.torques, N),
        (exchange.statuswords, N),
        (exchange.error_codes, N),
        (exchange.untrusted, N),
        (exchange.sampled_ns, N),
        (exchange.doubt_ns, N),
        (exchange.cell_tick, CELLS),
        (exchange.cell_status, CELLS),
        (exchange.cell_emergency, CELLS),
    ]
    seen = set()
    for number, (column, rows) in enumerate(columns):
        for row in range(rows):
            place = exchange.place(column, row)
            exchange.integers[place] = 100 * number + row
            seen.add(place)
    for number, (column, rows) in enumerate(columns):
        assert column.tolist() == [100 * number + row for row in range(rows)]
    for row in range(CELLS):
        place = exchange.place(exchange.cells, row)
        exchange.reals[place] = 0.5 + row
        seen.add(place)
    assert exchange.cells.tolist() == [0.5 + row for row in range(CELLS)]
    words = N * AXIS.itemsize // 8 + CELLS * CELL.itemsize // 8
    assert seen == set(range(words))
    assert len(exchange.integers) == words
