"""The whole examination, and the last one of this boot kept for the logs."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tonus.config.schema.root import Config
from tonus.runtime.timing.clock import wall_seconds
from tonus.tools.doctor import disk, kernel, network, privileges, wakeup
from tonus.tools.doctor.files import read
from tonus.tools.doctor.finding import Finding, worst

Report = dict[str, Any]
"""JSON object: ``verdict``, ``config``, ``period_us``, ``host``, ``seconds`` measured, ``boot`` and
s since then as ``at_s``, ``findings`` as a list of `Finding`."""

QUICK_S = 0.3
_DISK_S = 1.0
_FRESH_S, _QUICK_FRESH_S = 24 * 3600.0, 3600.0


def examine(
    config: Config, out: Path, seconds: float, say: Callable[[str], None] = lambda _: None
) -> list[Finding]:
    """Look at everything; takes about three times ``seconds``, half of it at real-time priority.

    Raises `ToolError` when ``out`` cannot be written to.
    """
    settings, limits = config.realtime, config.realtime.host
    rates = config.control.rates
    say(f"waking up every {rates.period_us} us for {seconds:g} s")
    awake, grants = wakeup.examine(settings, limits, seconds, rates.period_ns)
    say("writing to the disk")
    written = disk.examine(out, limits, min(seconds, _DISK_S))
    return [
        *awake,
        *privileges.examine(grants),
        *kernel.examine(),
        *network.examine(config, limits),
        *written,
    ]


def report(config: Config, findings: list[Finding], seconds: float) -> Report:
    """``findings`` of an examination for ``config`` that has just been made."""
    return {
        "verdict": worst(findings),
        "config": config.name,
        "period_us": config.control.rates.period_us,
        "host": f"{platform.node()}, {platform.machine()}, {platform.version()}",
        "seconds": seconds,
        "boot": _boot(),
        "at_s": wall_seconds(),
        "findings": [asdict(finding) for finding in findings],
    }


def keep(found: Report) -> None:
    """For the logs of the runs to come. A place that cannot be written to keeps nothing."""
    path = _kept()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    except OSError:
        return


def latest(config: Config, out: Path) -> Report:
    """The last report for ``config`` and of this boot, at most a day old, or an hour if it was a
    quick one; else a quick one, made and kept now."""
    try:
        found = json.loads(_kept().read_text(encoding="utf-8"))
        age = wall_seconds() - float(found["at_s"])
        fresh = _FRESH_S if found["seconds"] > QUICK_S else _QUICK_FRESH_S
        same = found["boot"] == _boot() and found["config"] == config.name
        same = same and found["period_us"] == config.control.rates.period_us
        if same and 0.0 <= age <= fresh:
            return {**found, "age_s": round(age, 1)}
    except (OSError, ValueError, KeyError, TypeError):
        pass  # none there, or not one of ours: made anew
    found = report(config, examine(config, out, QUICK_S), QUICK_S)
    keep(found)
    return found


def metadata(found: Report) -> dict[str, str]:
    """What a log's metadata say of it; the rest is in its attachment."""
    figures = {entry["name"]: entry["figures"] for entry in found["findings"]}
    rows = {"doctor.verdict": str(found["verdict"]), "doctor.seconds": f"{found['seconds']:g}"}
    for name, value in figures.get("wake-up", {}).items():
        rows[f"doctor.wakeup_{name}"] = f"{value:g}"
    return rows


def _boot() -> str:
    return read("/proc/sys/kernel/random/boot_id") or ""


def _kept() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "tonus" / "doctor.json"
