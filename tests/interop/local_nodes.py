"""python-canopen's LocalNode as drives and force cells of the robot: independent slaves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

from tonus.config import Config, load


def variable(
    index: int, sub: int, value: object, kind: int = UNSIGNED32, access: str = "rw"
) -> ODVariable:
    made = ODVariable(f"object {index:04X}:{sub}", index, sub)
    made.data_type = kind
    made.access_type = access
    made.default = value
    return made


def dictionary(objects: dict[tuple[int, int], tuple[object, int, str]]) -> ObjectDictionary:
    od = ObjectDictionary()
    records: dict[int, ODRecord] = {}
    several = {index for index, sub in objects if sub}
    for (index, sub), (value, kind, access) in objects.items():
        made = variable(index, sub, value, kind, access)
        if index in several:
            if index not in records:
                records[index] = ODRecord(f"record {index:04X}", index)
                od.add_object(records[index])
            records[index].add_member(made)
        else:
            od.add_object(made)
    return od


def epos4(node_id: int) -> ObjectDictionary:
    objects: dict[tuple[int, int], tuple[object, int, str]] = {
        (0x1008, 0): ("EPOS4", VISIBLE_STRING, "const"),
        (0x1016, 1): (0, UNSIGNED32, "rw"),
        (0x1016, 2): (0, UNSIGNED32, "rw"),
        (0x1017, 0): (0, UNSIGNED16, "rw"),
        (0x1029, 1): (1, UNSIGNED8, "rw"),
        (0x1018, 1): (0xFB, UNSIGNED32, "ro"),
        (0x1018, 2): (0x65510000, UNSIGNED32, "ro"),
        (0x1018, 3): (0x01700000, UNSIGNED32, "ro"),
        (0x3001, 1): (8000, UNSIGNED32, "rw"),
        (0x3001, 2): (30000, UNSIGNED32, "rw"),
        (0x3001, 4): (40, UNSIGNED16, "rw"),
        (0x3001, 5): (0, UNSIGNED32, "rw"),
        (0x3010, 1): (500, UNSIGNED32, "rw"),
        (0x603F, 0): (0, UNSIGNED16, "ro"),
        (0x6040, 0): (0, UNSIGNED16, "rw"),
        (0x6041, 0): (0x0240, UNSIGNED16, "ro"),
        (0x6060, 0): (1, INTEGER8, "rw"),
        (0x6064, 0): (0, INTEGER32, "ro"),
        (0x6071, 0): (0, INTEGER16, "rw"),
        (0x6076, 0): (568_000, UNSIGNED32, "rw"),
        (0x6077, 0): (0, INTEGER16, "ro"),
        (0x6080, 0): (50_000, UNSIGNED32, "rw"),
        (0x6085, 0): (10_000, UNSIGNED32, "rw"),
        (0x60B2, 0): (300, INTEGER16, "rw"),
        (0x60C2, 1): (0, UNSIGNED8, "rw"),
    }
    for index in (0x6007, 0x605A, 0x605B, 0x605C, 0x605E):
        objects[index, 0] = (1, INTEGER16, "rw")
    for base, mapping, cob_id in ((0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)):
        for number in range(4):
            objects[base + number, 1] = (cob_id + 0x100 * number + node_id, UNSIGNED32, "rw")
            objects[base + number, 2] = (255, UNSIGNED8, "rw")
            objects[mapping + number, 0] = (0, UNSIGNED8, "rw")
            for sub in range(1, 9):
                objects[mapping + number, sub] = (0, UNSIGNED32, "rw")
    return dictionary(objects)


def force_cell(node_id: int) -> ObjectDictionary:
    objects: dict[tuple[int, int], tuple[object, int, str]] = {
        (0x1017, 0): (0, UNSIGNED16, "rw"),
        (0x1018, 1): (0xFFFF, UNSIGNED32, "ro"),
        (0x1018, 2): (0x404, UNSIGNED32, "ro"),
        (0x1018, 3): (1, UNSIGNED32, "ro"),
        (0x1800, 1): (0x180 + node_id, UNSIGNED32, "rw"),
        (0x1800, 2): (255, UNSIGNED8, "rw"),
        (0x1A00, 0): (0, UNSIGNED8, "rw"),
        (0x1A00, 1): (0, UNSIGNED32, "rw"),
        (0x6131, 1): (0x00210000, UNSIGNED32, "ro"),
        (0x6132, 1): (0, UNSIGNED8, "rw"),
        (0x9130, 1): (0, INTEGER32, "ro"),
    }
    return dictionary(objects)


def boots_when_reset(network: canopen.Network, node: Any) -> None:
    """LocalNode obeys a reset in silence; a device says boot-up and is pre-operational."""

    def on_command(_: int, data: bytearray, __: float) -> None:
        if data[0] in (0x81, 0x82) and data[1] in (0, node.id):
            node.nmt.send_command(data[0])
            node.nmt.send_command(0x80)

    network.subscribe(0, on_command)


@contextmanager
def local_nodes(channel: str, nodes: dict[int, ObjectDictionary]) -> Iterator[list[Any]]:
    network = canopen.Network()
    network.connect(interface="virtual", channel=channel)
    try:
        made = [network.add_node(canopen.LocalNode(node, od)) for node, od in nodes.items()]
        for node in made:
            boots_when_reset(network, node)
        yield made
    finally:
        for node in network.values():
            node.nmt.stop_heartbeat()
        network.disconnect()


def robot_on(prefix: str) -> Config:
    config = load("config/can.yaml")[0]
    channels = tuple(
        channel.model_copy(update={"name": f"{prefix}{number}"})
        for number, channel in enumerate(config.fieldbus.channels)
    )
    master = config.fieldbus.master.model_copy(
        update={"sdo_timeout_ms": 2000, "boot_timeout_ms": 5000}
    )
    update = {"interface": "virtual", "channels": channels, "master": master}
    return config.model_copy(update={"fieldbus": config.fieldbus.model_copy(update=update)})


_STATUSWORD = {0x00: 0x0240, 0x06: 0x0231, 0x07: 0x0233, 0x0F: 0x0237, 0x80: 0x0240}
"""by the controlword that leads there"""


class Drive:
    """A LocalNode that behaves as a drive: python-canopen has no SYNC-driven PDOs of its own.

    Torque is followed at once, and every SYNC moves the drum by ten increments.
    """

    def __init__(self, network: canopen.Network, node: Any) -> None:
        self.node = node
        self.values = {0x6041: 0x0240, 0x6064: 0, 0x6077: 0}
        self._received: dict[int, int] | None = None
        network.subscribe(0, self._on_command)
        network.subscribe(0x80, self._on_sync)

    def _on_command(self, _: int, data: bytearray, __: float) -> None:
        if data[0] == 0x01 and data[1] in (0, self.node.id):
            self.node.tpdo[1].read()
            if 0x1400 in self.node.object_dictionary:
                self.node.rpdo[1].read()
                self.node.rpdo[1].add_callback(self._on_rpdo)

    def _on_rpdo(self, message: Any) -> None:
        self._received = {each.index: each.raw for each in message.map}

    def _on_sync(self, _: int, __: bytearray, ___: float) -> None:
        if self.node.nmt.state != "OPERATIONAL":
            return
        out = self.node.tpdo[1]
        for each in out.map:
            each.raw = self.values[each.index]
        out.transmit()
        if self._received is not None:
            word = self._received[0x6040]
            if word == 0x0F and self.values[0x6041] == 0x0240:
                word = 0x00  # nothing in switch-on disabled
            self.values[0x6041] = _STATUSWORD[word]
            self.values[0x6077] = self._received[0x6071]
            self.values[0x6064] += 10


class Cell(Drive):
    """A LocalNode that sends its process value at every SYNC."""

    def __init__(self, network: canopen.Network, node: Any) -> None:
        super().__init__(network, node)
        self.values = {0x9130: 100 * node.id}
