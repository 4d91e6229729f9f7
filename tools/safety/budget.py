"""Times of reactions, computed from the configuration's keys: no page states one by itself."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import Any

from tonus.config import Config, load
from tonus.config.loader import load_bounds
from tonus.config.schema.bus import CanopenBus, EthercatBus
from tonus.config.timeouts import master_timeout_ms, node_timeout_ms, watchdog_ms
from tonus.tools.errors import ToolError

_TICKS = re.compile(r"^(\d+) ticks?$")
_UNITS = {"_s": 1.0, "_ms": 1e-3, "_us": 1e-6}
_BOUNDS = "bounds."


def seconds(text: str) -> float:
    """Of a sum of keys and whole ticks such as ``control.freshness.stale_stop_ticks + 1 tick``.

    A key is one of config/can.yaml, of ``sto_relay`` one of config/ethercat.yaml, after
    ``bounds.`` one of config/bounds.yaml, or a timeout that follows from periods and tolerances
    (``timeouts.master``, ``timeouts.node``, ``timeouts.watchdog``; config/timeouts.py). Raises
    `ToolError`.
    """
    return sum(_term(term.strip()) for term in text.split("+"))


def shown(text: str) -> str:
    """The time and the keys that it comes from, for a cell of a table."""
    terms = [term.strip() for term in text.split("+")]
    named = " + ".join(term if _TICKS.match(term) else f"`{term}`" for term in terms)
    time = _rounded(seconds(text))
    return time if all(_TICKS.match(term) for term in terms) else f"{time} ({named})"


def _rounded(value: float) -> str:
    return f"{value:.3g} s" if value >= 1.0 else f"{1e3 * value:.3g} ms"


def _term(text: str) -> float:
    config = _segment() if text.startswith("sto_relay.") else _config()
    period = config.control.rates.period
    ticks = _TICKS.match(text)
    if ticks is not None:
        return int(ticks[1]) * period
    if text in _TIMEOUTS:
        return 1e-3 * _TIMEOUTS[text]()
    bounded = text.startswith(_BOUNDS)
    value = _at(load_bounds() if bounded else config, text.removeprefix(_BOUNDS), text)
    if bounded:
        return value
    if text.endswith("_ticks"):
        return value * period
    for ending, unit in _UNITS.items():
        if text.endswith(ending):
            return value * unit
    raise ToolError(f"{text}: is no time; give a key that ends with _ticks, _s, _ms or _us")


def _at(place: Any, path: str, text: str) -> float:
    for name in path.split("."):
        place = place.get(name) if isinstance(place, dict) else getattr(place, name, None)
    if not isinstance(place, int | float):
        raise ToolError(f"{text}: there is no such key with a number; see docs/configuration.md")
    return float(place)


@cache
def _config() -> Config:
    return load("config/can.yaml")[0]


def _master() -> int:
    bus = _config().fieldbus
    assert isinstance(bus, CanopenBus)
    return master_timeout_ms(bus, bus.drive, _config().tolerance)


def _node() -> int:
    bus = _config().fieldbus
    assert isinstance(bus, CanopenBus)
    return node_timeout_ms(bus.drive, bus.master, _config().tolerance)


@cache
def _segment() -> Config:
    return load("config/ethercat.yaml")[0]


def _watchdog() -> int:
    config = _segment()
    assert isinstance(config.fieldbus, EthercatBus)
    return watchdog_ms(config.fieldbus, config.tolerance, config.control.rates.period_us)


_TIMEOUTS: dict[str, Callable[[], int]] = {
    "timeouts.master": _master,
    "timeouts.node": _node,
    "timeouts.watchdog": _watchdog,
}
