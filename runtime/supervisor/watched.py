"""Which frames of each channel the supervisor reads, and which tell that a device answers."""

from __future__ import annotations

from tonus.runtime.supervisor.commands import REQUEST, told_by
from tonus.runtime.supervisor.listener import Heard, Watched
from tonus.runtime.supervisor.observation import Listened
from tonus.runtime.supervisor.wiring import Value, Wiring

HEARTBEAT, OUTPUT = 0x700, 0x200
"""Identifiers (CiA 301): of heartbeats, and of a relay's output, with the node's number added"""
_STATE = Value(0, 8)
"""of a heartbeat"""
_EMERGENCY_BYTES = 8


def watched_on(wiring: Wiring, channel: str) -> list[Watched]:
    """Every identifier of a channel that tells of an axis or a cell."""
    axes = [axis for axis in wiring.axes if axis.channel == channel]
    cells = [cell for cell in wiring.cells if cell.channel == channel]
    requests = {axis.request for axis in axes} | {cell.request for cell in cells}
    found = told_by(sorted(request - REQUEST for request in requests))
    for axis in axes:
        values = (axis.torque,)
        told = Watched(axis.sent, axis.sent_bytes, values, command=True, sync=axis.sync)
        found.append(told._replace(controlword=axis.controlword))
        found.append(Watched(axis.received, axis.received_bytes, (), axis.statusword))
        found.append(Watched(axis.heartbeat, 1, (_STATE,)))
    forces: dict[int, tuple[int, list[Value]]] = {}
    for cell in cells:
        forces.setdefault(cell.received, (cell.received_bytes, []))[1].append(cell.force)
    found += [Watched(key, size, tuple(values)) for key, (size, values) in forces.items()]
    for emergency, heartbeat in sorted({(cell.emergency, cell.heartbeat) for cell in cells}):
        found.append(Watched(emergency, _EMERGENCY_BYTES, (), errors=True))
        found.append(Watched(heartbeat, 1, (_STATE,)))
    return found


def watched_of_relay(node: int) -> list[Watched]:
    """Every identifier that tells of a relay's node."""
    output = Watched(OUTPUT + node, 1, (), command=True)
    return [Watched(HEARTBEAT + node, 1, (_STATE,)), output, *told_by([node])]


def watched_of_amplifiers(wiring: Wiring, channel: str) -> list[Watched]:
    """Every identifier by which the amplifiers of a channel are told anything, and by which they
    say that they have booted, where the record has the rest."""
    cells = [cell for cell in wiring.cells if cell.channel == channel]
    beats = [Watched(key, 1, (_STATE,)) for key in sorted({cell.heartbeat for cell in cells})]
    return [*beats, *told_by(sorted({cell.request - REQUEST for cell in cells}))]


def answers(wiring: Wiring, channel: str, heard: Listened) -> tuple[list[Heard], list[Heard]]:
    """Of the drives of a channel, and of all of its devices."""
    drives = [heard[channel, axis.received] for axis in wiring.axes if axis.channel == channel]
    cells = [heard[channel, cell.received] for cell in wiring.cells if cell.channel == channel]
    return drives, drives + cells
