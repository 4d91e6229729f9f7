"""Values that are right in another unit: said before anything is computed from them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tonus.config import Config
from tonus.config.loader import load_plausible
from tonus.config.schema.plausible import Bound
from tonus.tools.check.finding import Finding


def plausibility(config: Config) -> Iterator[Finding]:
    """One finding for each implausible value, or one that all are plausible."""
    bounds = load_plausible().bounds
    wrong = [each for each in (_judge(config, bound) for bound in bounds) if each is not None]
    if not wrong:
        text = f"{len(bounds)} values are of the size that their units let expect"
        yield Finding("units", True, "robot", text, "give SI units")
    yield from wrong


def _judge(config: Config, bound: Bound) -> Finding | None:
    value: Any = config
    for part in bound.key.split("."):
        value = getattr(value, part)
    found = bound.largest(value)
    if bound.low <= found <= bound.high:
        return None
    what = f"{found:g} {bound.unit}, where {bound.low:g} to {bound.high:g} are plausible"
    remedy = f"give it in {bound.unit}"
    if bound.low <= found / bound.factor <= bound.high:
        what += f"; it looks like {bound.mistaken}"
        remedy = f"give it in {bound.unit}: {found / bound.factor:g}"
    return Finding("units", False, bound.key, what, remedy)
