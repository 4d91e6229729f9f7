"""Values of a configuration without a lab that are less safe than a robot's defaults."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.document import Key, dotted
from tonus.config.schema.place import (
    DEFAULTS,
    LARGEST_JITTER_MS,
    LARGEST_PATIENCE_MS,
    LARGEST_PERIOD_MS,
    LARGEST_RELAY_TIMEOUT_MS,
    LARGEST_STALE_TICKS,
    LARGEST_TIMEOUT_MS,
)
from tonus.config.schema.root import Config


def unnamed_risks(config: Config) -> Iterator[tuple[Key, str, str]]:
    """Key, problem and remedy of each that is not named under ``relaxed``; none with a lab."""
    if config.lab is not None:
        return
    for key, problem in _risks(config):
        name = dotted(key)
        if name in config.relaxed:
            continue
        safe = DEFAULTS[key][0]
        yield key, problem, f"leave it out (then it is {safe}), or write {name} under relaxed"


def _risks(config: Config) -> Iterator[tuple[Key, str]]:
    realtime, freshness = config.realtime, config.control.freshness
    if realtime.policy != "require":
        yield ("realtime", "policy"), f"{realtime.policy} lets a robot run on a host that is late"
    if realtime.overrun == "skip":
        yield ("realtime", "overrun"), "skip lets a robot go on whatever ticks are missed"
    if realtime.overrun_ticks > freshness.measurement_ticks:
        yield (
            ("realtime", "overrun_ticks"),
            f"{realtime.overrun_ticks} missed ticks stop nothing, measurements are fresh for "
            f"{freshness.measurement_ticks}",
        )
    if freshness.stale_stop_ticks > LARGEST_STALE_TICKS:
        yield (
            ("control", "freshness", "stale_stop_ticks"),
            f"{freshness.stale_stop_ticks} ticks without a measurement stop nothing, on a robot "
            f"more than {LARGEST_STALE_TICKS} are too many",
        )
    supervisor = config.supervisor
    if supervisor is not None and supervisor.policy == "use":
        yield ("supervisor", "policy"), "use lets a robot be armed without its supervisor"
    if supervisor is not None and supervisor.patience_ms > LARGEST_PATIENCE_MS:
        yield (
            ("supervisor", "patience_ms"),
            f"{supervisor.patience_ms:g} ms are how long it lets a wrong daemon go on, on a robot "
            f"more than {LARGEST_PATIENCE_MS} are too many",
        )
    if supervisor is not None and supervisor.period_ms > LARGEST_PERIOD_MS:
        yield (
            ("supervisor", "period_ms"),
            f"{supervisor.period_ms} ms are between two of its looks, on a robot more than "
            f"{LARGEST_PERIOD_MS} are too many",
        )
    if supervisor is not None and supervisor.timeout_ms > LARGEST_TIMEOUT_MS:
        yield (
            ("supervisor", "timeout_ms"),
            f"{supervisor.timeout_ms} ms are how long drives go on without it, on a robot more "
            f"than {LARGEST_TIMEOUT_MS} are too many",
        )
    relay = config.relay
    if relay is not None and relay.timeout_ms > LARGEST_RELAY_TIMEOUT_MS:
        yield (
            ("sto_relay", "timeout_ms"),
            f"{relay.timeout_ms} ms are how long drives go on without their supervisor, on a robot "
            f"more than {LARGEST_RELAY_TIMEOUT_MS} are too many",
        )
    if config.tolerance.jitter_ms > LARGEST_JITTER_MS:
        yield (
            ("tolerance", "jitter_ms"),
            f"{config.tolerance.jitter_ms} ms make drives without a daemon wait for longer, on a "
            f"robot more than {LARGEST_JITTER_MS} are too many",
        )
