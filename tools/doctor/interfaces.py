"""Network interfaces of this host, by the kernel's type."""

from __future__ import annotations

from pathlib import Path

from tonus.tools.doctor.files import read

NET = Path("/sys/class/net")
ETHERNET, CAN = "1", "280"
"""ARPHRD types of the kernel"""


def interfaces(kind: str) -> list[str]:
    """Their names, sorted."""
    if not NET.is_dir():
        return []
    return sorted(path.name for path in NET.iterdir() if read(path / "type") == kind)
