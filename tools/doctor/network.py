"""CAN interfaces with their transmit queues, and network cards that EtherCAT could have."""

from __future__ import annotations

from tonus.config.schema.realtime import HostLimits
from tonus.config.schema.root import Config
from tonus.tools.doctor.files import read
from tonus.tools.doctor.finding import Finding
from tonus.tools.doctor.interfaces import CAN, ETHERNET, NET, interfaces
from tonus.tools.fieldbus.registry import fieldbus_kind


def examine(config: Config, limits: HostLimits) -> list[Finding]:
    """What ``config`` needs of its buses, and every wired card."""
    needed = [
        finding
        for bus in config.fieldbus.parts
        for finding in fieldbus_kind(bus).examine(config, bus, limits)
    ]
    return [*(needed or [_no_can(config)]), _ethercat()]


def _no_can(config: Config) -> Finding:
    there = ", ".join(interfaces(CAN)) or "none"
    text = f"{there}; {config.name} needs none, its bus is in software"
    return Finding("CAN interfaces", text)


def _ethercat() -> Finding:
    """A card of its own, that nothing else is routed over."""
    name, routed, free, busy = "EtherCAT", _routed(), [], []
    for card in interfaces(ETHERNET):
        if not (NET / card / "device").exists() or (NET / card / "wireless").exists():
            continue
        driver = (NET / card / "device" / "driver").resolve().name
        if card in routed:
            busy.append(f"{card} ({driver}) carries IP traffic")
        else:
            link = "link up" if read(NET / card / "carrier") == "1" else "no link"
            free.append(f"{card} ({driver}, {link})")
    text = "; ".join(free + busy) or "no wired network card"
    return Finding(name, f"usable: {text}" if free else f"no free card: {text}")


def _routed() -> set[str]:
    """Interfaces that a route leads to."""
    lines = (read("/proc/net/route") or "").splitlines()[1:]
    return {line.split()[0] for line in lines if line.split()}
