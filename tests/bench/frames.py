"""What a frame costs on the lab's bus, beside python-can's own virtual bus and python-canopen."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import can
import canopen
import numpy as np
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

from tests.bench.measure import Figure, microseconds
from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.root import Config
from tonus.sim.can import registry
from tonus.sim.can.plugin import TonusBus
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.timing import frame_bits
from tonus.sim.lab.engine import Lab

RECEIVERS = 9
FRAMES = 4000
FRAMES_A_ROUND = 200
"""Short rounds: of many, some meet no noise."""
CYCLES = 200
ROUNDS = 3
_FRAME_NS = 200_000
_CYCLE_NS = 1_000_000
_LIMIT = 64
"""Frames taken at once, at most."""
_SYNC = 0x080
_SET_POINT = struct.pack("<Hh", 0x0F, 40)


def frames() -> list[Figure]:
    """Frames a second through the bus alone, and process data of the whole robot."""
    by_message, by_array, theirs = one_to_nine()
    data = bytes(range(8))
    bits = microseconds(lambda: frame_bits(0x181, 8, data), repeats=20_000)
    config, _ = load("config/can.yaml")
    count = _frames_a_cycle(config)
    lab, nodes = _lab_cycle() / count, _local_nodes_cycle(config) / count
    return [
        Figure(
            "a frame sent and received by nine, recv()",
            by_message,
            "us",
            "python-can virtual",
            theirs,
            f"{_rate(by_message)} against {_rate(theirs)}; ours has bit timing, stuffing,"
            " arbitration",
        ),
        Figure(
            "a frame sent and received by nine, receive_frames()",
            by_array,
            "us",
            "python-can virtual, recv()",
            theirs,
            f"{_rate(by_array)}; as the daemon receives",
        ),
        Figure(
            "a frame of the robot's process data",
            lab,
            "us",
            "python-canopen LocalNode on python-can virtual",
            nodes,
            f"{_rate(lab)} against {_rate(nodes)}; {count} a cycle, 17 nodes, four channels;"
            " ours has drives, cells and the robot's plant behind them, theirs constants",
        ),
        Figure("length of a frame with its stuff bits", bits, "us"),
    ]


def _rate(us: float) -> str:
    return f"{1e6 / us:,.0f} frames/s"


class _BusAlone:
    """A channel with nothing behind it, as a lab."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.channel = FaultyChannel("bench", 1_000_000, 32, 0)

    def clock(self) -> int:
        return self.now_ns

    def advance(self, to_ns: int) -> None:
        self.channel.run(to_ns)

    def call_at(self, at_ns: int, callback: Callable[[int], None]) -> None:
        raise NotImplementedError


def one_to_nine() -> tuple[float, float, float]:
    """us of a frame sent by one bus and received by nine: on the lab's bus as messages and as
    arrays, and on python-can's virtual bus. In alternation, so that all meet the same noise."""
    lab = _BusAlone()
    registry.enter("bench", registry.Door(lab, lab.channel, 1_000_000))

    def pass_time() -> None:
        lab.now_ns += _FRAME_NS

    try:
        with _joined("tonus") as ours, _joined("virtual") as theirs:
            ways = (
                _one_to_all(ours, pass_time, [partial(bus.recv, 0) for bus in ours[1:]]),
                _one_to_all(ours, pass_time, [_arrays_of(bus) for bus in ours[1:]]),
                _one_to_all(theirs, lambda: None, [partial(bus.recv, 0) for bus in theirs[1:]]),
            )
            for way in ways:
                assert [_count(taken) for taken in way()] == [1] * RECEIVERS
            rounds = [
                [microseconds(way, repeats=FRAMES_A_ROUND, rounds=1) for way in ways]
                for _ in range(FRAMES // FRAMES_A_ROUND)
            ]
    finally:
        registry.leave("bench")
    by_message, by_array, virtual = (min(of_way) for of_way in zip(*rounds, strict=True))
    return by_message, by_array, virtual


@contextmanager
def _joined(interface: str) -> Iterator[list[can.BusABC]]:
    buses = [can.Bus(interface=interface, channel="bench") for _ in range(RECEIVERS + 1)]
    try:
        yield buses
    finally:
        for bus in buses:
            bus.shutdown()


def _arrays_of(bus: can.BusABC) -> Callable[[], object]:
    assert isinstance(bus, TonusBus)
    return partial(bus.receive_frames, _LIMIT)


def _count(taken: object) -> int:
    """Of frames."""
    return len(taken) if isinstance(taken, np.ndarray) else isinstance(taken, can.Message)


def _one_to_all(
    buses: list[can.BusABC], pass_time: Callable[[], None], receive: list[Callable[[], object]]
) -> Callable[[], list[object]]:
    """What each has received is returned."""
    sender = buses[0]
    message = can.Message(arbitration_id=0x7A0, data=bytes(8), is_extended_id=False)

    def once() -> list[object]:
        sender.send(message)
        pass_time()
        return [take() for take in receive]

    return once


def _channels(config: Config) -> list[tuple[str, list[int], list[int]]]:
    """Name, drives and cells of each."""
    bus = config.fieldbus
    assert isinstance(bus, CanopenBus)
    return [
        (spec.name, [d.node_id for d in spec.drives], [c.node_id for c in spec.force_cells])
        for spec in bus.channels
    ]


def _frames_a_cycle(config: Config) -> int:
    return sum(1 + 2 * len(drives) + len(cells) for _, drives, cells in _channels(config))


def _cycle(
    config: Config, buses: dict[str, can.BusABC], respond: Callable[[], None]
) -> Callable[[], None]:
    """A master's cycle: SYNC, set-points, and every answer taken."""
    plan = []
    for name, drives, cells in _channels(config):
        messages = [can.Message(arbitration_id=_SYNC, is_extended_id=False)]
        messages += [
            can.Message(arbitration_id=0x200 + node, is_extended_id=False, data=_SET_POINT)
            for node in drives
        ]
        plan.append((buses[name], messages, len(drives) + len(cells)))

    def once() -> None:
        for bus, messages, _ in plan:
            for message in messages:
                bus.send(message)
        respond()
        for bus, _, expected in plan:
            for _ in range(expected):
                assert bus.recv(timeout=0) is not None

    return once


def _lab_cycle() -> float:
    config, scenario = load("config/can.yaml")
    now = [0]
    lab = Lab(config, scenario.lab, seed=1, clock=lambda: now[0])
    lab.open()
    buses = {name: can.Bus(interface="tonus", channel=name) for name in lab.channels}

    def pass_time() -> None:
        now[0] += _CYCLE_NS
        lab.advance(now[0])

    try:
        for name, drives, cells in _channels(config):
            for node in (*drives, *cells):
                for index, sub, value, size in _mapping(node, node in drives):
                    data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
                    request = can.Message(
                        arbitration_id=0x600 + node, is_extended_id=False, data=data
                    )
                    buses[name].send(request)
                    pass_time()
            buses[name].send(can.Message(is_extended_id=False, data=b"\1\0"))
            pass_time()
            while buses[name].recv(timeout=0) is not None:
                pass
        return microseconds(_cycle(config, buses, pass_time), repeats=CYCLES, rounds=ROUNDS)
    finally:
        for bus in buses.values():
            bus.shutdown()
        lab.close()


def _mapping(node: int, drive: bool) -> list[tuple[int, int, int, int]]:
    """Index, subindex, value, size: SYNC-driven process data as the robot has them."""
    steps = [(0x1800, 1, 0xC0000180 + node, 4), (0x1800, 2, 1, 1)]
    if drive:
        steps += [(0x1A00, 0, 0, 1), (0x1A00, 1, 0x60410010, 4), (0x1A00, 2, 0x60640020, 4)]
        steps += [(0x1A00, 3, 0x60770010, 4), (0x1A00, 0, 3, 1)]
        steps += [(0x1400, 1, 0x80000200 + node, 4), (0x1600, 0, 0, 1)]
        steps += [(0x1600, 1, 0x60400010, 4), (0x1600, 2, 0x60710010, 4), (0x1600, 0, 2, 1)]
        steps += [(0x1400, 2, 1, 1), (0x1400, 1, 0x200 + node, 4)]
    return [*steps, (0x1800, 1, 0x40000180 + node, 4)]


def _local_nodes_cycle(config: Config) -> float:
    """The peer as its user would have it at its fastest: no thread, one network a channel."""
    buses: dict[str, can.BusABC] = {}
    networks = []
    for name, drives, cells in _channels(config):
        buses[name] = can.Bus(interface="virtual", channel=name)
        network = canopen.Network(can.Bus(interface="virtual", channel=name))
        networks.append((network, 1 + len(drives)))
        for node in drives:
            _answer(network, node, (0x6041, 0x6064, 0x6077), (0x6040, 0x6071))
        for node in cells:
            _answer(network, node, (0x9130,), ())

    def respond() -> None:
        for network, expected in networks:
            for _ in range(expected):
                message = network.bus.recv(timeout=0)
                assert message is not None
                network.notify(message.arbitration_id, message.data, message.timestamp)

    try:
        return microseconds(_cycle(config, buses, respond), repeats=CYCLES, rounds=ROUNDS)
    finally:
        for bus in (*buses.values(), *(network.bus for network, _ in networks)):
            bus.shutdown()


_TYPES = {
    0x6040: datatypes.UNSIGNED16,
    0x6041: datatypes.UNSIGNED16,
    0x6064: datatypes.INTEGER32,
    0x6071: datatypes.INTEGER16,
    0x6077: datatypes.INTEGER16,
    0x9130: datatypes.INTEGER32,
}


def _answer(
    network: canopen.Network, number: int, sent: tuple[int, ...], received: tuple[int, ...]
) -> None:
    """A LocalNode that takes its RPDO, and sends its TPDO at every SYNC."""
    objects = canopen.ObjectDictionary()
    for index in (*sent, *received):
        variable = ODVariable(f"object {index:X}", index)
        variable.data_type = _TYPES[index]
        objects.add_object(variable)
    for index in (0x1400, 0x1600, 0x1800, 0x1A00):
        record = ODRecord(f"pdo {index:X}", index)
        for sub in range(4):
            member = ODVariable(f"sub {sub}", index, sub)
            member.data_type = datatypes.UNSIGNED32 if sub else datatypes.UNSIGNED8
            record.add_member(member)
        objects.add_object(record)
    node = network.create_node(number, objects)
    tpdo, rpdo = node.tpdo[1], node.rpdo[1]
    tpdo.cob_id, rpdo.cob_id = 0x180 + number, 0x200 + number
    for pdo, indices in ((tpdo, sent), (rpdo, received)):
        for index in indices:
            pdo.add_variable(index)
    values = [0]

    def on_sync(*_: object) -> None:
        values[0] = (values[0] + 1) % 1000
        for variable in tpdo:
            variable.raw = values[0]
        tpdo.transmit()

    network.subscribe(_SYNC, on_sync)
    if received:
        network.subscribe(rpdo.cob_id, rpdo.on_message)
