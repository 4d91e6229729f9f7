"""CAN interfaces with their transmit queues, and network cards that EtherCAT could have."""

from __future__ import annotations

from pathlib import Path

from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.realtime import HostLimits
from tonus.config.schema.root import Config
from tonus.tools.doctor.files import read
from tonus.tools.doctor.finding import Finding, Verdict

_NET = Path("/sys/class/net")
_ETHERNET, _CAN = "1", "280"
"""ARPHRD types of the kernel"""


def examine(config: Config, limits: HostLimits) -> list[Finding]:
    """The channels that ``config`` names, and every wired card."""
    return [*_can(config, limits), _ethercat()]


def _can(config: Config, limits: HostLimits) -> list[Finding]:
    bus, there = config.fieldbus, _interfaces(_CAN)
    if not (isinstance(bus, CanopenBus) and bus.interface == "socketcan"):
        text = f"{', '.join(there) or 'none'}; {config.name} needs none, its bus is in software"
        return [Finding("CAN interfaces", text)]
    found = []
    for channel in bus.channels:
        name = channel.name
        up = f"sudo ip link set {name} up type can bitrate {bus.bitrate} restart-ms 100"
        title = f"CAN {name}"
        if name not in there:
            found.append(Finding(title, "there is no such interface", Verdict.BAD, up))
        elif read(_NET / name / "operstate") not in ("up", "unknown"):
            found.append(Finding(title, "down", Verdict.BAD, up))
        else:
            length = int(read(_NET / name / "tx_queue_len") or 0)
            enough = length >= limits.can_queue
            remedy = f"sudo ip link set {name} txqueuelen {limits.can_queue}"
            found.append(
                Finding(
                    title,
                    f"up, transmit queue of {length} frames",
                    Verdict.GOOD if enough else Verdict.BETTER,
                    "" if enough else remedy,
                )
            )
    return found


def _interfaces(kind: str) -> list[str]:
    if not _NET.is_dir():
        return []
    return sorted(path.name for path in _NET.iterdir() if read(path / "type") == kind)


def _ethercat() -> Finding:
    """A card of its own, that nothing else is routed over."""
    name, routed, free, busy = "EtherCAT", _routed(), [], []
    for card in _interfaces(_ETHERNET):
        if not (_NET / card / "device").exists() or (_NET / card / "wireless").exists():
            continue
        driver = (_NET / card / "device" / "driver").resolve().name
        if card in routed:
            busy.append(f"{card} ({driver}) carries IP traffic")
        else:
            link = "link up" if read(_NET / card / "carrier") == "1" else "no link"
            free.append(f"{card} ({driver}, {link})")
    text = "; ".join(free + busy) or "no wired network card"
    return Finding(name, f"usable: {text}" if free else f"no free card: {text}")


def _routed() -> set[str]:
    """Interfaces that a route leads to."""
    lines = (read("/proc/net/route") or "").splitlines()[1:]
    return {line.split()[0] for line in lines if line.split()}
