"""What can be known about an EtherCAT segment before anything is started."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.bus import EthercatBus
from tonus.drivers.errors import DriverError
from tonus.drivers.ethercat.frames import COUNTER_BYTES, HEADER_BYTES, MAXIMUM_DATA
from tonus.drivers.ethercat.slave import slaves
from tonus.drivers.ethercat.status import MOST
from tonus.tools.check.finding import Finding

BYTE_NS = 80
"""100 Mbit/s."""
AROUND_BYTES = 8 + 14 + 2 + 4 + 12
"""Preamble, Ethernet and EtherCAT header, checksum and gap of a frame."""
HOP_NS = 1000
"""A slave and the cable to the next, one way; ETG gives 500 to 1000 ns."""
CLOCK_BYTES = 8
LOAD_LIMIT = 0.5
"""Of the period that may be frames: mailboxes and states use what is left over."""


def check_ethercat(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    """Every rule's outcome, in a fixed order; nothing raises."""
    yield from _frames(config, bus)
    yield from _times(config, bus)
    yield _slaves(bus)
    yield from _interfaces(config, bus)


def _frames(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    try:
        segment = slaves(bus, config.robot)
        data = sum(each.sizes.outputs + each.sizes.inputs for each in segment)
        problem = ""
    except DriverError as error:
        problem, data = str(error), 0
    yield Finding(
        "process data",
        not problem,
        "fieldbus.slaves",
        problem or f"{len(bus.slaves)} slaves exchange {data} bytes",
        "correct the mappings",
    )
    if problem:
        return
    size = data + CLOCK_BYTES + 2 * (HEADER_BYTES + COUNTER_BYTES)
    frame_ns = (size + AROUND_BYTES) * BYTE_NS + 2 * HOP_NS * len(bus.slaves)
    period_us = config.control.rates.period_us
    share = frame_ns / (1e3 * period_us)
    fits = size <= MAXIMUM_DATA and share <= LOAD_LIMIT
    yield Finding(
        "bus load",
        fits,
        f"fieldbus {bus.interface}",
        f"segment {bus.interface}: one frame of {size} bytes, back after {frame_ns / 1e3:.0f} us "
        f"({100 * share:.1f} % of {period_us} us), the limit is {100 * LOAD_LIMIT:g} % and "
        f"{MAXIMUM_DATA} bytes",
        "map less, or use a longer period",
    )


def _times(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    clocks, master = bus.clocks, bus.master
    period_us = config.control.rates.period_us
    guarded = clocks.shift_us + clocks.guard_us
    yield Finding(
        "SYNC0",
        guarded <= clocks.frame_us <= period_us + clocks.shift_us - clocks.guard_us,
        "fieldbus.clocks",
        f"SYNC0 {clocks.shift_us:g} us after the tick began, the frame after "
        f"{clocks.frame_us:g} us, apart by at least {clocks.guard_us:g} us",
        "let the frame pass between one SYNC0 and the next",
    )
    yield Finding(
        "lost frames",
        master.receive_timeout_us <= period_us / 2,
        "fieldbus.master.receive_timeout_us",
        f"a lost frame costs {master.receive_timeout_us} us of a tick of {period_us} us",
        "wait for no more than half a period",
    )


def _slaves(bus: EthercatBus) -> Finding:
    return Finding(
        "slaves",
        len(bus.slaves) <= MOST,
        "fieldbus.slaves",
        f"{len(bus.slaves)} slaves, whose states one frame can ask for up to {MOST}",
        "use two segments",
    )


def _interfaces(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    names = bus.interfaces
    if config.lab is not None:
        far = config.lab.ethercat
        text = "the lab has no end of the segment" if far is None else far.interface
        yield Finding(
            "lab",
            far is not None,
            "lab.ethercat",
            f"the lab's end: {text}",
            "add lab.ethercat with an interface",
        )
        if far is not None:
            names.append(far.interface)
    apart = len(set(names)) == len(names)
    yield Finding(
        "interfaces",
        apart,
        "fieldbus.interface",
        f"interfaces {', '.join(names)}" + ("" if apart else ": one is named twice"),
        "give every end of a cable its own interface",
    )
