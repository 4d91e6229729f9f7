"""Indicators of the paper's programme as figures of a study, by the formulas of `tonus paper`."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.states import State
from tonus.tools.log import Log
from tonus.tools.paper.case import Kind
from tonus.tools.paper.metrics import measure
from tonus.tools.paper.printed import OURS, TABLE3
from tonus.tools.paper.recorded import recorded

INDICATORS: dict[str, frozenset[Kind]] = {}
"""by name: the tests that it is taken from"""
for _indicator in (*(row[0] for row in TABLE3), *OURS):
    _kinds = INDICATORS.get(_indicator.key, frozenset())
    INDICATORS[_indicator.key] = _kinds | _indicator.kinds


def taken(
    log: Log, config: Config, scenario: Scenario, names: Sequence[str]
) -> dict[str, float | None]:
    """By name, in SI units or what the name says; None where the test, or this run, has none."""
    if State.ACTIVE not in log["/tonus/state"]["state"]:
        return dict.fromkeys(names)
    trial = recorded(log, config, scenario)
    kind, found = trial.run.case.kind, measure(trial)
    return {name: found.get(name) if kind in INDICATORS[name] else None for name in names}
