"""What is known of a run when it is judged: records, truth, events, faults, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.process_image import AxisState
from tonus.runtime.signals import TABLE
from tonus.runtime.states import Fault, State
from tonus.tools.campaign.strikes import Strike, strikes
from tonus.tools.errors import ToolError
from tonus.tools.log.attached import configuration, played
from tonus.tools.log.log import Event, Log
from tonus.tools.run.provenance import SCRIPT_START
from tonus.tools.run.summary import TRUTH

Ints = NDArray[np.int64]
Rows = NDArray[np.void]
Cycle = Mapping[str, Rows] | Rows
"""Rows of each topic by its short name: a structured array of the cycle record, or a log's."""

GOOD, FAULTED = 0, 1
"""exit codes of `tonus run`"""


@dataclass(frozen=True)
class End:
    """How a run ended, by the daemon's own word."""

    state: State
    fault: Fault
    reason: str
    exit_code: int


@dataclass(frozen=True)
class Observed:
    """A run. ``cycle`` and ``truth`` have their times in ns beside them, of one clock."""

    config: Config
    scenario: Scenario
    cycle: Cycle
    cycle_ns: Ints
    truth: Rows
    truth_ns: Ints
    events: Sequence[Event]
    strikes: Sequence[Strike] = ()
    end: End | None = None
    """None: nobody knows more than the records tell"""
    error: str = ""
    """an exception of the program, in words"""
    cut: bool = False
    """it was left in the middle: the state of its last record is no end"""

    @property
    def state(self) -> NDArray[np.uint8]:
        return np.asarray(self.cycle["state"]["state"])

    def at_truth(self, values: NDArray[Any], before: Any) -> NDArray[Any]:
        """Values of ticks (n, ...) at the truth's times (m, ...): the latest known, and
        ``before`` ahead of the first tick."""
        last = np.searchsorted(self.cycle_ns, self.truth_ns, side="right") - 1
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.where((last >= 0).reshape(shape), values[np.maximum(last, 0)], before)


def of_log(log: Log, named: frozenset[str] = frozenset()) -> Observed:
    """A recorded run. Its faults are those of its scenario, and their time zero the first tick that
    found every drive enabled. ``named``: kinds of faults that an event has to name. Raises
    `ToolError`."""
    if TRUTH not in log:
        raise ToolError(f"{log.path}: holds no truth, so it cannot be judged; run it in the lab")
    topics = [topic.name for topic in TABLE if topic.name in log]
    log.load([*topics, TRUTH])
    cycle = {name.rsplit("/", 1)[1]: log[name] for name in topics}
    times = log.times("/tonus/timing")
    enabled = (cycle["drives"]["state"] == AxisState.OPERATION_ENABLED).all(axis=1)
    config, scenario = configuration(log), played(log)
    found: list[Strike] = []
    if enabled.any():
        told = log.metadata.get(SCRIPT_START)
        start_ns = int(times[enabled.argmax()]) if told is None else int(told)
        found = strikes(config, scenario.lab.faults, start_ns, named)
    found = [strike for strike in found if strike.at_ns <= times[-1]]
    return Observed(
        config,
        scenario,
        cycle,
        times,
        log[TRUTH],
        log.times(TRUTH),
        log.events(),
        found,
    )
