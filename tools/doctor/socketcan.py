"""The SocketCAN interfaces that a configuration names, with their transmit queues."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.realtime import HostLimits
from tonus.config.schema.root import Config
from tonus.tools.doctor.files import read
from tonus.tools.doctor.finding import Finding, Verdict
from tonus.tools.doctor.interfaces import CAN, NET, interfaces


def examine(config: Config, bus: CanopenBus, limits: HostLimits) -> Iterator[Finding]:
    """One outcome for each channel; none where the bus is not SocketCAN's."""
    del config
    if bus.interface != "socketcan":
        return
    there = interfaces(CAN)
    for channel in bus.channels:
        name = channel.name
        up = f"sudo ip link set {name} up type can bitrate {bus.bitrate} restart-ms 100"
        title = f"CAN {name}"
        if name not in there:
            yield Finding(title, "there is no such interface", Verdict.BAD, up)
        elif read(NET / name / "operstate") not in ("up", "unknown"):
            yield Finding(title, "down", Verdict.BAD, up)
        else:
            length = int(read(NET / name / "tx_queue_len") or 0)
            enough = length >= limits.can_queue
            remedy = f"sudo ip link set {name} txqueuelen {limits.can_queue}"
            yield Finding(
                title,
                f"up, transmit queue of {length} frames",
                Verdict.GOOD if enough else Verdict.BETTER,
                "" if enough else remedy,
            )
