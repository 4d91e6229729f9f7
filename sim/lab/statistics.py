"""What a lab's channels have carried: load, latency, errors, as plain values for JSON."""

from __future__ import annotations

from collections import deque
from typing import TypedDict

from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.frame import EXTENDED, EXTENDED_ID, REMOTE
from tonus.sim.can.wire.latency import Summary
from tonus.sim.can.wire.port import Port

PERIOD_NS = 100_000_000
"""How often the load is noted."""
_NOTES = 11
_SECOND_NS = 1_000_000_000


class LoadWindow:
    """Busy share of a channel over the last second, in steps of a tenth."""

    def __init__(self, channel: FaultyChannel, now_ns: int) -> None:
        self._channel = channel
        self._notes = deque([(now_ns, channel.busy_ns)], _NOTES)

    def note(self, now_ns: int) -> None:
        self._notes.append((now_ns, self._channel.busy_ns))

    def load(self, now_ns: int) -> float:
        since_ns, busy_ns = self._notes[0]
        passed = now_ns - since_ns
        return (self._channel.busy_ns - busy_ns) / passed if passed else 0.0


class Controller(TypedDict):
    state: str
    transmit_errors: int
    receive_errors: int
    queued: int
    overflows: int
    missed: int
    retransmissions: int
    connected: bool
    """on the channel's own wire"""


class ChannelStatistics(TypedDict):
    load: float
    """busy share since the start, spaces between frames included"""
    load_1s: float
    frames: int
    error_frames: int
    overflows: int
    """frames lost or refused at full transmit queues"""
    missed: int
    """frames that a full receive queue did not take"""
    retransmissions: int
    controllers: dict[str, Controller]
    latency: dict[str, Summary]
    """by identifier; from the queue to the end of frame; empty unless it is measured"""


class Statistics(TypedDict):
    time: float
    """the lab's, s"""
    channels: dict[str, ChannelStatistics]


def _controller(port: Port, channel: FaultyChannel) -> Controller:
    return Controller(
        state=port.errors.state.value,
        transmit_errors=port.errors.transmit,
        receive_errors=port.errors.receive,
        queued=port.waiting,
        overflows=port.overflows,
        missed=port.missed,
        retransmissions=port.retransmissions,
        connected=port.channel is channel,
    )


def _identifier(flagged: int) -> str:
    width = 8 if flagged & EXTENDED else 3
    remote = " remote" if flagged & REMOTE else ""
    return f"0x{flagged & EXTENDED_ID:0{width}X}{remote}"


def channel_statistics(
    channel: FaultyChannel, window: LoadWindow, start_ns: int, now_ns: int
) -> ChannelStatistics:
    """All of one channel, the controllers that are cut off included."""
    ports = [*channel.ports, *(port for wire in channel.severed for port in wire.ports)]
    latency = {} if channel.latency is None else channel.latency.summary()
    passed = now_ns - start_ns
    return ChannelStatistics(
        load=channel.busy_ns / passed if passed else 0.0,
        load_1s=window.load(now_ns),
        frames=channel.frames,
        error_frames=channel.error_frames,
        overflows=sum(port.overflows for port in ports),
        missed=sum(port.missed for port in ports),
        retransmissions=sum(port.retransmissions for port in ports),
        controllers={port.name: _controller(port, channel) for port in ports},
        latency={_identifier(flagged): summary for flagged, summary in latency.items()},
    )
