"""Runs in virtual time with a supervisor, in which the daemon is changed from some instant on, and
what a bus of the test's own hears of the drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import can

from tests.loop import QUICK
from tonus.config import Config, load
from tonus.config.schema.scenario import Scenario
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Playing

STRICT = {
    "supervisor.period_ms": 2,
    "supervisor.timeout_ms": 17,
    "supervisor.patience_ms": 5,
}
"""As on a robot, but for the margin that EPOS4 drives want (docs/supervisor.md)."""
_ALONE = ("control.sequence.tare_s", "supervisor.policy")
BRIEF = {key: value for key, value in QUICK.items() if key not in _ALONE}
"""Overrides for a quick bring-up, in which the supervisor begins while the cells are tared."""
DRIVES = range(1, 9)
REPORT_MS = 0.26
"""the emergency frames of the two drives on a channel, 0.13 ms each: the drives stop before them"""
_EMERGENCY, _HEARTBEAT_LOST = 0x080, 0x8130
_SUPERVISOR = 126
_MOST = 1000
"""frames of a tick"""


def configured(path: str = "config/can.yaml", **overrides: object) -> tuple[Config, Scenario]:
    return load(path, overrides={**STRICT, **overrides})


class Over(Exception):  # noqa: N818 - nothing is wrong
    """The run has been seen for as long as was asked."""


@dataclass
class Run:
    """Plays until some seconds after a change at ``at`` s in ``state``."""

    config: Config
    scenario: Scenario
    change: Callable[[], None] = lambda: None
    state: State = State.ACTIVE
    at: float = 0.5
    changed_ns: int = 0
    stopped_ns: dict[int, int] = field(default_factory=dict)
    """by node: when its drive lost the supervisor's heartbeat"""
    said: list[tuple[int, float]] = field(default_factory=list)
    """requirement and value, of each emergency frame of the supervisor"""
    _buses: list[Any] = field(default_factory=list)

    def play(self, seconds: float = 0.3) -> Observed:
        self._left = round(seconds / self.config.control.rates.period)
        self._playing = Playing(
            self.config, self.scenario, 1, tail=0.5, longest=60.0, turn=self._before_tick
        )
        return self._playing.run()

    @property
    def slowest_ms(self) -> float:
        """From the change to the last drive that stopped by itself; infinite if not all did."""
        if len(self.stopped_ns) < len(DRIVES):
            return float("inf")
        return (max(self.stopped_ns.values()) - self.changed_ns) * 1e-6

    def _before_tick(self, playing: Playing) -> None:
        if not self._buses:
            self._buses = [can.Bus(interface="tonus", channel=name) for name in self._channels()]
        self._listen()
        last = playing._cycles.last
        if self.changed_ns == 0:
            state = last["state"] if last is not None else None
            if state is not None and state["state"] == self.state and state["elapsed"] >= self.at:
                self.changed_ns = clock.now_ns()
                self.change()
        elif self._left == 0:
            for bus in self._buses:
                bus.shutdown()
            raise Over  # a daemon that was changed may not come to an end by itself
        self._left -= self.changed_ns > 0

    def _channels(self) -> list[str]:
        return [channel.name for channel in self.config.fieldbus.channels]  # type: ignore[attr-defined]

    def _listen(self) -> None:
        for bus in self._buses:
            frames = bus.receive_frames(_MOST)  # as messages they take a tenth of the run's time
            early = frames[frames["identifier"] <= _EMERGENCY + _SUPERVISOR]
            for stamp_ns, identifier, *_, data in early.tolist():
                code, node = data & 0xFFFF, identifier - _EMERGENCY
                if node == _SUPERVISOR:
                    self.said.append((code - 0xFF00, stamp_ns * 1e-9))
                elif node in DRIVES and code == _HEARTBEAT_LOST:
                    self.stopped_ns.setdefault(node, stamp_ns)
