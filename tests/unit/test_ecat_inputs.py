"""The inputs of a segment's slaves: what stands in their bytes, where control reads it."""

from __future__ import annotations

import pytest

from tonus.config import load
from tonus.config.schema.bus import EthercatBus
from tonus.drivers.cia301.pdo import Mapping
from tonus.drivers.ethercat.inputs import Inputs
from tonus.drivers.ethercat.slave import slaves
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import ProcessImage


def test_every_value_comes_to_its_place_with_its_sign_and_its_time() -> None:
    config, _ = load("config/ethercat.yaml")
    bus = config.fieldbus
    assert isinstance(bus, EthercatBus)
    image, fresh = ProcessImage(8), config.control.freshness
    places = [str(axis) for axis in range(8)]
    exchange = Exchange(config.robot, bus.force_cell, fresh, image, EventLog(), places)
    built = slaves(bus, config.robot)
    inputs = Inputs(built, exchange)
    data = []
    for slave in built:
        if slave.axis is not None:
            words = (0xF237, -(1 << 31) + slave.axis, -slave.axis, 0xFF00 + slave.axis)
        else:
            words = tuple(word for cell in slave.cells for word in (-1000 * cell - 1, 255 - cell))
        data.append(Mapping.of(slave.tx).layout.pack(*words))
    everyone = [True] * len(built)
    inputs.take(data, everyone, 7, 1_000_000, 20)
    assert exchange.statuswords.tolist() == [0xF237] * 8
    assert exchange.positions.tolist() == [-(1 << 31) + axis for axis in range(8)]
    assert exchange.torques.tolist() == [-axis for axis in range(8)]
    assert exchange.error_codes.tolist() == [0xFF00 + axis for axis in range(8)]
    assert exchange.cells.tolist() == [-1000.0 * cell - 1.0 for cell in range(9)]
    assert exchange.cell_status.tolist() == [255 - cell for cell in range(9)]
    assert exchange.axis_tick.tolist() == [7] * 8
    assert exchange.cell_tick.tolist() == [7] * 9
    assert exchange.sampled_ns.tolist() == [1_000_000] * 8
    assert exchange.doubt_ns.tolist() == [20] * 8
    with pytest.raises(ValueError, match="buffer"):
        inputs.take(data[:-1], everyone, 8, 0, 0)
    missing = [slave.axis != 3 and 0 not in slave.cells for slave in built]
    inputs.take([bytes(len(each)) for each in data], missing, 8, 2_000_000, 0)
    assert exchange.axis_tick.tolist() == [7 if axis == 3 else 8 for axis in range(8)]
    assert exchange.positions.tolist() == [-(1 << 31) + 3 if axis == 3 else 0 for axis in range(8)]
    absent = next(slave.cells for slave in built if 0 in slave.cells)
    assert exchange.cell_tick.tolist() == [7 if cell in absent else 8 for cell in range(9)]
