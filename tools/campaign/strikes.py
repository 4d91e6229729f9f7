"""When a fault struck, what it concerns, and what an event has to say to name it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from tonus.config.schema.bus import EthercatBus, of_kind
from tonus.config.schema.bus.base import numbers
from tonus.config.schema.faults import Fault
from tonus.config.schema.root import Config
from tonus.config.timeouts import watchdog_ms

NS = 1_000_000_000
_ENDING = ("clear", "replug")
"""Kinds that end what another fault began."""
_TRACKER = ("tracker", "estimator")


@dataclass(frozen=True)
class Strike:
    """One fault at work."""

    kind: str
    at_ns: int
    """on the clock of the records"""
    axes: frozenset[int] = frozenset()
    """whose cable, drum, motor or drive it concerns"""
    cells: frozenset[int] = frozenset()
    places: tuple[str, ...] = ()
    """further words that name it in an event's place"""
    unpowered: frozenset[int] = frozenset()
    """axes without power whatever control does: STO, no supply, or out of the master's reach on a
    segment for longer than the drives' watchdog"""
    named: bool = False
    """an event has to name its place"""
    pushes: tuple[tuple[int, int], ...] = ()
    """first and last ns in which it does work on the platform from outside"""
    words: str = ""
    """as `tonus fault` has it"""

    def is_named_by(self, where: str) -> bool:
        """Whether an event's place points at this fault."""
        told = {int(number) for number in re.findall(r"\b(?:axis|cell) (\d+)\b", where)}
        return bool(told & (self.axes | self.cells)) or any(word in where for word in self.places)


def strikes(
    config: Config, faults: Iterable[Fault], start_ns: int, named: frozenset[str]
) -> list[Strike]:
    """Of a lab's script that began at ``start_ns``, in the order of time. ``named``: the kinds that
    an event has to name."""
    found = [
        _strike(config, fault, start_ns + round(fault.at * NS), named)
        for fault in faults
        if fault.kind not in _ENDING
    ]
    return sorted(found, key=lambda strike: strike.at_ns)


def _strike(config: Config, fault: Any, at_ns: int, named: frozenset[str]) -> Strike:
    kind: str = fault.kind
    axis, cell = getattr(fault, "axis", None), getattr(fault, "cell", None)
    axes = {axis} if axis is not None else set()
    cells = {cell} if cell is not None else set()
    channel, node = getattr(fault, "channel", None), getattr(fault, "node", None)
    places: tuple[str, ...] = ()
    if channel is not None:
        axes, cells = devices(config, channel, node)
        places = (channel,) if node is None else (f"{channel}/{node} ",)
    elif kind.startswith("tracker"):
        places = _TRACKER
    if kind == "sto" and axis is None:
        axes = set(range(config.robot.cables))
    wired = kind == "drive_input" and fault.active and fault.input in ("sto", "drive_enable")
    off = axes if wired or kind in ("sto", "power_loss") else set()
    return Strike(
        kind,
        at_ns,
        frozenset(axes),
        frozenset(cells | axes),
        places,
        unpowered=frozenset(off | _out_of_reach(config, fault)),
        named=kind in named,
        pushes=tuple(
            (at_ns + round(begin * NS), at_ns + round(end * NS)) for begin, end in _pushes(fault)
        ),
        words=str(fault),
    )


def _out_of_reach(config: Config, fault: Any) -> set[int]:
    """Axes behind the break of an EtherCAT line. A ring reaches them from its other end."""
    if fault.kind not in ("cable_break", "power_loss"):
        return set()
    bus = next(
        bus for bus in of_kind(config.fieldbus, EthercatBus) if bus.interface == fault.channel
    )
    period_us = config.control.rates.period_us
    # Up to a period may pass from the last frame that gets through to its begin, and from its end
    # to the first one.
    longest = watchdog_ms(bus, config.tolerance, period_us) - 2.0 * period_us * 1e-3
    short = fault.duration is not None and fault.duration * 1e3 < longest
    if short or bus.redundant_interface is not None:
        return set()
    last = fault.behind if fault.kind == "cable_break" else fault.node
    return {node.axis for node in bus.nodes() if node.number > last and node.axis is not None}


def _pushes(fault: Any) -> list[tuple[float, float]]:
    """s after its begin in which it pushes the platform: a load until it is gone, a phantom while
    it moves, there and back."""
    if fault.kind == "load":
        return [(0.0, fault.duration + fault.rise)]
    if fault.kind == "phantom_hit":
        moves = fault.distance / fault.speed
        back = fault.duration
        return [(0.0, moves)] + ([] if back is None else [(back, back + moves)])
    return []


def devices(config: Config, channel: str, node: int | None) -> tuple[set[int], set[int]]:
    """Axes and cells on a channel or segment, or of one of its nodes."""
    found = [
        each
        for each in config.fieldbus.nodes()
        if each.channel == channel and node in (None, each.number)
    ]
    axes, cells = numbers(found)
    return set(axes), set(cells)
