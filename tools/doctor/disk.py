"""Whether the disk keeps up with a recording, and where the rings lie."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from tonus.config.places import IN_MEMORY, file_system, runtime_dir
from tonus.config.schema.realtime import HostLimits
from tonus.runtime.timing.clock import wall_seconds
from tonus.tools.doctor.finding import Finding, Verdict, graded
from tonus.tools.errors import ToolError

_MIB = 1 << 20
_LARGEST = 256 * _MIB


def examine(out: Path, limits: HostLimits, seconds: float) -> list[Finding]:
    """Write for at most ``seconds`` into ``out``. Raises `ToolError`."""
    return [_written(out, limits, seconds), _rings()]


def _written(out: Path, limits: HostLimits, seconds: float) -> Finding:
    """MiB/s with fsync after each MiB, for at most ``seconds``. Raises `ToolError`."""
    block, written, slowest = os.urandom(_MIB), 0, 0.0
    path = out / ".doctor"
    try:
        out.mkdir(parents=True, exist_ok=True)
        with path.open("wb", buffering=0) as file:
            began = before = wall_seconds()
            while written < _LARGEST and before - began < seconds:
                file.write(block)
                os.fsync(file.fileno())
                now = wall_seconds()
                slowest, before = max(slowest, now - before), now
                written += _MIB
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another folder with --out") from error
    finally:
        with suppress(OSError):
            path.unlink()
    rate = written / _MIB / (before - began)
    verdict = graded(rate, limits.disk_good_mib_s, limits.disk_bad_mib_s)
    figures = {"mib_per_s": round(rate, 1), "slowest_ms": round(slowest * 1e3, 1)}
    text = f"{rate:.0f} MiB/s into {out}, slowest MiB {slowest * 1e3:.0f} ms"
    remedy = "" if verdict is Verdict.GOOD else "record to another disk with --out"
    return Finding("disk", text, verdict, remedy, figures)


def _rings() -> Finding:
    """On a disk, the kernel's writing of their pages makes the next record fault, and wait."""
    name, where = "rings", runtime_dir()
    kind = file_system(where)
    if kind in IN_MEMORY:
        return Finding(name, f"{where}, in memory ({kind})")
    remedy = "export TONUS_RUNTIME_DIR=/dev/shm/tonus"
    return Finding(name, f"{where}, on a disk ({kind})", Verdict.BETTER, remedy)
