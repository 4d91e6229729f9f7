"""What of the daemon's wishes this host grants to this user."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.runtime.timing.realtime import Grant
from tonus.tools.doctor.finding import Finding, Verdict

_LIMITS = "/etc/security/limits.d/tonus.conf"
_DMA = "/dev/cpu_dma_latency"
_REMEDIES = (
    ("SCHED_FIFO", f'echo "@realtime - rtprio 90" | sudo tee -a {_LIMITS}'),
    ("mlockall", f'echo "@realtime - memlock unlimited" | sudo tee -a {_LIMITS}'),
    ("CPU DMA latency", f"sudo chgrp realtime {_DMA}; sudo chmod g+w {_DMA}"),
    (
        "kernel workers",
        "boot with isolcpus and the daemon's processor, and set realtime.kernel_workers: null",
    ),
    ("processor", "set realtime.daemon_cpu to a processor of this host, or to null"),
)


def examine(grants: Sequence[Grant]) -> list[Finding]:
    """Of all that was asked of the host, one finding for each refusal; or one that says none."""
    refused = [grant for grant in grants if not grant.granted]
    if not refused:
        items = ", ".join(grant.item for grant in grants)
        return [Finding("privileges", f"granted: {items}")]
    return [
        Finding(grant.item, f"refused: {grant.detail}", Verdict.BAD, _remedy(grant.item))
        for grant in refused
    ]


def _remedy(item: str) -> str:
    for start, remedy in _REMEDIES:
        if item.startswith(start):
            return remedy
    return ""
