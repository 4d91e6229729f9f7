"""Our master, process data and all, against python-canopen's LocalNode on all four channels."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
import pytest
from interop.local_nodes import Cell, Drive, epos4, force_cell, local_nodes, robot_on

from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.fieldbus import BusEvent
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.timing.clock import RealTimeLoop

PAUSE_S = 0.004
"""wall time between two ticks: the nodes answer from threads of their own"""
PATIENCE = 2500
"""ticks until what must happen has happened"""


class Exchange:
    """The master and its nodes; ``events`` collects what is told."""

    def __init__(self, fieldbus: CanopenFieldbus, image: ProcessImage) -> None:
        self.fieldbus = fieldbus
        self.image = image
        self.tick = 0
        self.events: list[BusEvent] = []
        self.drives: dict[int, Drive] = {}

    async def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(PATIENCE):
            self.fieldbus.collect(self.tick)
            self.fieldbus.publish(self.tick)
            self.tick += 1
            self.events += self.fieldbus.take_events()
            await asyncio.sleep(PAUSE_S)
            if condition():
                return
        pytest.fail(f"not within {PATIENCE} ticks; events: {self.events}")

    def told(self, name: str) -> list[BusEvent]:
        return [event for event in self.events if event.name == name]

    def all_in(self, state: AxisState) -> bool:
        axes = self.image.axes
        return bool((axes["state"] == state).all() and (axes["age"] <= 1).all())


async def exchange(bus: Exchange) -> None:
    """Enable, follow a torque, lose a node to pre-operational, bring it back."""
    image = bus.image
    await bus.until(lambda: bus.all_in(AxisState.SWITCH_ON_DISABLED))
    image.commands["command"] = AxisCommand.ENABLE
    await bus.until(lambda: bus.all_in(AxisState.OPERATION_ENABLED))
    torque = 0.7 * np.array([1, -1, 2, -2, 3, -3, 4, -4])
    image.commands["torque"] = torque
    one_mille = 0.568e-3 * 49 / 4
    await bus.until(lambda: bool(np.allclose(image.axes["torque"], torque, atol=one_mille)))
    before = image.axes["angle"].copy()
    await bus.until(lambda: bool((image.axes["angle"] > before).all()))
    assert image.cells["force"].tolist() == [float(node) for node in range(17, 26)]
    assert not {"short_pdo", "long_pdo", "foreign_frame"} & {event.name for event in bus.events}

    bus.drives[5].node.emcy.send(0x8120, 0x10)
    await bus.until(lambda: bool(bus.told("emcy")))
    assert image.axes["error_code"][4] == 0x8120
    assert "CAN error-passive" in bus.told("emcy")[0].text
    bus.drives[5].node.nmt.state = "PRE-OPERATIONAL"
    bus.drives[5].values[0x6041] = 0x0240
    await bus.until(lambda: image.axes["state"][4] == AxisState.LOST)
    image.commands["command"] = AxisCommand.DISABLE
    recovery = asyncio.create_task(bus.fieldbus.recover())
    await bus.until(lambda: recovery.done() and bool(bus.told("recovered")))
    recovery.result()
    assert [event.where[-2:] for event in bus.told("recovered")] == ["/5"]
    image.commands["command"] = AxisCommand.ENABLE
    await bus.until(lambda: bus.all_in(AxisState.OPERATION_ENABLED))


@pytest.mark.wide
def test_process_data_are_exchanged_with_seventeen_independent_nodes() -> None:
    config = robot_on("exchange")

    async def work() -> None:
        image = ProcessImage(8)
        bus = Exchange(CanopenFieldbus(config, image), image)
        with ExitStack() as networks:
            for channel in config.fieldbus.channels:
                ods = {drive.node_id: epos4(drive.node_id) for drive in channel.drives}
                ods |= {cell.node_id: force_cell(cell.node_id) for cell in channel.force_cells}
                for node in networks.enter_context(local_nodes(channel.name, ods)):
                    kind = Drive if node.id <= 8 else Cell
                    bus.drives[node.id] = kind(node.network, node)
            await bus.fieldbus.start(lambda _: None)
            try:
                await exchange(bus)
            finally:
                await bus.fieldbus.stop()

    with asyncio.Runner(loop_factory=RealTimeLoop) as runner:
        runner.run(work())
