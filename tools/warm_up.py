"""What a run compiles, loads and tells of its host, done once before processes part."""

from __future__ import annotations

from contextlib import suppress
from functools import cache

from tonus.config import Config, load
from tonus.config.schema.scenario import Scenario
from tonus.runtime.operation.rehearsal import rehearse
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.tools.run.provenance import environment

_WARM_NS = 20_000_000


@cache
def warm_up(name: str) -> None:
    """`warm`, for the configuration of this name."""
    warm(*load(name))


def warm(config: Config, scenario: Scenario) -> None:
    """What runs with these have in common, so that it need not be done in each of their processes.
    That their lab cannot be built each run says itself."""
    environment()
    rehearse(config, scenario)
    with suppress(LabError):
        lab = Lab(config, scenario.lab, seed=0, clock=lambda: 0)
        lab.advance(_WARM_NS)
        lab.close()
