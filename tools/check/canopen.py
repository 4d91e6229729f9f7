"""What can be known about channels of CANopen before anything is started."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from tonus.config import Config
from tonus.config.busload import channel_load
from tonus.config.schema.bus import CanopenBus, Channel
from tonus.config.schema.supervisor import Supervisor
from tonus.drivers.canopen import identifiers
from tonus.tools.check.finding import Finding


@dataclass(frozen=True)
class _Node:
    name: str
    node_id: int
    base_identifiers: tuple[int, ...]


def check_canopen(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    """Every rule's outcome, in a fixed order; nothing raises."""
    period_us = config.control.rates.period_us
    # One that holds a relay beats on the relay's channel alone.
    supervisor = config.supervisor if config.relay is None else None
    yield from _period(bus, period_us)
    yield _channel_names(config, bus)
    for channel in bus.channels:
        yield from _load(bus, channel, period_us, supervisor)
        yield from _identifiers(bus, channel, supervisor)


def _period(bus: CanopenBus, period_us: int) -> Iterator[Finding]:
    heartbeat_us = bus.master.heartbeat_ms * 1000
    fits = heartbeat_us % period_us == 0
    yield Finding(
        "period",
        fits,
        "control.rates.period_us",
        f"the master's heartbeat of {bus.master.heartbeat_ms} ms is "
        f"{heartbeat_us / period_us:g} cycles of {period_us} us",
        "choose a period that divides fieldbus.master.heartbeat_ms",
    )


def _channel_names(config: Config, bus: CanopenBus) -> Finding:
    names = Counter(name for part in config.fieldbus.parts for name in part.can_channels)
    twice = [name for name, count in names.items() if count > 1]
    text = f"{twice[0]} is given twice" if twice else f"{len(bus.channels)} channels"
    return Finding(
        "channel names", not twice, "fieldbus.channels", text, "give every channel its own name"
    )


def _load(
    bus: CanopenBus, channel: Channel, period_us: int, supervisor: Supervisor | None
) -> Iterator[Finding]:
    load = channel_load(bus, channel, period_us, supervisor)
    yield Finding(
        "bus load",
        load.share <= bus.load_limit,
        f"fieldbus.channels {channel.name}",
        f"channel {channel.name} carries {load.cyclic_us:.0f} us of frames in a cycle of "
        f"{period_us} us ({100 * load.cyclic_share:.1f} %, with heartbeats "
        f"{100 * load.share:.1f} %), the limit is {100 * bus.load_limit:g} %",
        "use more channels or a longer period",
    )


def _nodes(bus: CanopenBus, channel: Channel, supervisor: Supervisor | None) -> Iterator[_Node]:
    every = (
        identifiers.EMCY,
        identifiers.SDO_RESPONSE,
        identifiers.SDO_REQUEST,
        identifiers.HEARTBEAT,
    )
    yield _Node("the master", bus.master.node_id, (identifiers.HEARTBEAT,))
    if supervisor is not None and supervisor.policy != "off":
        own = (identifiers.EMCY, identifiers.HEARTBEAT)
        yield _Node("the supervisor", supervisor.node_id, own)
    for each in channel.drives:
        profile = bus.profile(each.axis)
        pdos = _pdos(profile.rpdo, profile.tpdo)
        yield _Node(f"axis {each.axis}", each.node_id, (*every, *pdos))
    for cell in channel.force_cells:
        pdos = _pdos(bus.force_cell.rpdo, bus.force_cell.tpdo)
        yield _Node(f"cell {' '.join(map(str, cell.cells))}", cell.node_id, (*every, *pdos))


def _pdos(rpdo: tuple[int, ...], tpdo: tuple[int, ...]) -> tuple[int, ...]:
    used = ((rpdo, identifiers.RPDO1), (tpdo, identifiers.TPDO1))
    return tuple(identifier for mapping, identifier in used if mapping)


def _identifiers(
    bus: CanopenBus, channel: Channel, supervisor: Supervisor | None
) -> Iterator[Finding]:
    where = f"fieldbus.channels {channel.name}"
    nodes = list(_nodes(bus, channel, supervisor))
    owners: dict[int, str] = {}
    clash = ""
    for node in nodes:
        if node.node_id in owners and not clash:
            clash = f"{owners[node.node_id]} and {node.name} both have node id {node.node_id}"
        owners.setdefault(node.node_id, node.name)
    yield Finding(
        "node ids",
        not clash,
        where,
        clash or f"{channel.name}: {len(nodes)} nodes, all different",
        "give every node of a channel, master and supervisor included, its own node id",
    )
    owners = {identifiers.NMT: "NMT", identifiers.SYNC: "SYNC"}
    clash = ""
    for node in nodes:
        for base in node.base_identifiers:
            cob_id = base + node.node_id
            if cob_id in owners and not clash:
                clash = f"{owners[cob_id]} and {node.name} both use COB-ID 0x{cob_id:03X}"
            owners.setdefault(cob_id, node.name)
    yield Finding(
        "COB-IDs",
        not clash,
        where,
        clash or f"{channel.name}: {len(owners)} identifiers, all apart",
        "change one of the two node ids",
    )
