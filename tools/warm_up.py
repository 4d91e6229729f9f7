"""What a run compiles and loads, done once before processes part."""

from __future__ import annotations

from functools import cache

from tonus.config import load
from tonus.runtime.operation.rehearsal import rehearse
from tonus.sim.lab.engine import Lab

_WARM_NS = 20_000_000


@cache
def warm_up(name: str) -> None:
    """Of the configuration of this name, so that it need not be done in each of them."""
    config, scenario = load(name)
    rehearse(config, scenario)
    lab = Lab(config, scenario.lab, seed=0, clock=lambda: 0)
    lab.advance(_WARM_NS)
    lab.close()
