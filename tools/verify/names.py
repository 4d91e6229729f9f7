"""Names in expectations, looked up before a scenario is played."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.config.schema.bus import SHIPPED
from tonus.config.schema.expectation import (
    Allowed,
    Expectation,
    Happens,
    Never,
    Rms,
    Settles,
    Stays,
)
from tonus.config.schema.root import Config
from tonus.runtime.topics import Per
from tonus.tools.errors import ToolError
from tonus.tools.expect.names import advice, full, need_known, signals


def need_names(config: Config, expectations: Sequence[Expectation]) -> None:
    """Raises `ToolError` for an event, a signal or an element of one that no run of this robot
    has. A fieldbus of somebody else may report events of its own."""
    ours = all(bus.kind in SHIPPED for bus in config.fieldbus.parts)
    for number, each in enumerate(expectations):
        try:
            if isinstance(each, Happens | Never | Allowed) and ours:
                need_known(each.event)
            elif isinstance(each, Stays | Settles | Rms):
                _need_signal(config.robot.cables, each)
        except ToolError as error:
            raise ToolError(f"expect.{number}: {error}") from None


def _need_signal(cables: int, each: Stays | Settles | Rms) -> None:
    topic = full(each.topic)
    size = signals().get(topic, {}).get(each.field)
    if size is None:
        hint = advice(topic, each.field) or "docs/log.md lists them"
        raise ToolError(f"there is no signal {topic}.{each.field}; {hint}")
    if each.index is not None:
        width = Per(size).count(cables) if size < 0 else size
        if each.index >= width:
            remedy = (
                f"choose one from 0 to {width - 1}" if width else "it is a scalar; leave it out"
            )
            raise ToolError(f"{topic}.{each.field} has no element {each.index}; {remedy}")
