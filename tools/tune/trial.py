"""One short run in virtual time, kept in memory: no files, no recorder, over when ACTIVE is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon
from tonus.runtime.operation.operator import Script
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.run.kept import Kept

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """What happened in ACTIVE; rows of ``cycle`` and ``truth`` belong to the same millisecond."""

    cycle: NDArray[np.void]
    truth: NDArray[np.void]
    fault: Fault

    @property
    def time(self) -> Array:
        """s since ACTIVE began"""
        return np.asarray(self.cycle["state"]["elapsed"])

    @property
    def error(self) -> Array:
        """(n, 3) m, desired less true position"""
        return np.asarray(self.cycle["pose"]["desired_position"] - self.truth["position"])


class _WithoutStop(Script):
    """Over as soon as ACTIVE is: nobody looks at the way down."""

    _been_there = False

    @property
    def finished(self) -> bool:
        return self._been_there or super().finished

    def next(self, sequence: Sequence) -> Operator:
        command = super().next(sequence)
        self._been_there = command is Operator.STOP or sequence.state is State.SAFE_STOP
        return command


def _unseen(*_: object, **__: object) -> None:
    """Events and progress are for people."""


def play(config: Config, scenario: Scenario, *, seed: int) -> Trial:
    """Run ``scenario`` on the direct fieldbus from OFF to the end of ACTIVE. ``config`` has a lab.

    The trial is empty when ACTIVE was not reached.
    """
    cables = config.robot.cables
    cycles, truths = Kept(cycle_dtype(cables)), Kept(truth_dtype(cables))

    async def main() -> Daemon:
        lab = Lab(config, scenario.lab, seed=seed, clock=clock.loop_clock(), truth=truths.publish)
        image = ProcessImage(config.robot.cables)
        daemon = Daemon(
            config,
            scenario,
            DirectFieldbus(config, image, lab.direct, clock.loop_clock()),
            TrackerInput(image, lab.tracker),
            _WithoutStop(scenario.duration),
            ring=cycles,
            events=_unseen,
            stopwatch=clock.Stopwatch(running=False),
        )
        await daemon.run(VirtualPacing, _unseen, _unseen)
        return daemon

    daemon = clock.run(main(), virtual=True)
    return _active(cycles, truths, daemon.cycle.sequence.fault)


def _active(cycles: Kept, truths: Kept, fault: Fault) -> Trial:
    """The rows of ACTIVE, truth beside them."""
    cycle, truth = cycles.rows, truths.rows
    at = np.searchsorted(truths.stamps, cycles.stamps)
    chosen = (cycle["state"]["state"] == State.ACTIVE) & (at < len(truth))
    return Trial(cycle[chosen], truth[at[chosen]], fault)
