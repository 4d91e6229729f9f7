"""How much of a log may be held in memory."""

from __future__ import annotations

from pathlib import Path

_SHARE = 0.5
_UNKNOWN = 1 << 32
"""bytes, where the kernel reports none"""


def memory_for_logs() -> int:
    """Bytes: half of what the machine has free, and of what a container may still take."""
    free = [_machine()]
    group = Path("/sys/fs/cgroup")
    try:
        limit = int((group / "memory.max").read_text())
        free.append(limit - int((group / "memory.current").read_text()))
    except (OSError, ValueError):
        pass  # no container, or one without a limit
    return int(_SHARE * min(free))


def _machine() -> int:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (OSError, ValueError):
        pass
    return _UNKNOWN
