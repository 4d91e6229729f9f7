"""The channels of labs in this process, by name: where a bus finds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from tonus.sim.devices.timers import Callback
from tonus.sim.errors import LabError

if TYPE_CHECKING:
    from tonus.sim.can.wire.faulty import FaultyChannel


class Advancing(Protocol):
    """The part of a lab that a bus needs."""

    @property
    def now_ns(self) -> int: ...
    @property
    def clock(self) -> Callable[[], int]: ...
    def advance(self, to_ns: int) -> None: ...
    def call_at(self, at_ns: int, callback: Callback) -> None: ...


@dataclass(frozen=True)
class Door:
    """A channel and the lab that brings it forward."""

    lab: Advancing
    channel: FaultyChannel
    bitrate: int


_open: dict[str, Door] = {}


def enter(name: str, door: Door) -> None:
    """Raises `LabError` if the name is taken."""
    if name in _open:
        raise LabError(f"channel {name} is open already in this process; close the other lab")
    _open[name] = door


def leave(name: str) -> None:
    """Nobody new finds the channel; who has it keeps it."""
    _open.pop(name, None)


def find(name: str) -> Door | None:
    """The open channel of this name in this process, if there is one."""
    return _open.get(name)
