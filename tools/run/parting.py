"""Runs that begin alike have one bring-up: each goes on from HOLD in a fork of the process, and is
bit for bit what it would have been from OFF."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.daemon import Daemon
from tonus.runtime.operation.operator import Script
from tonus.runtime.safety.sequence import Sequence as ControlSequence
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.sim.plant.parameters import clearance
from tonus.tools.forking import die_with_parent

_HOLD = State.HOLD


def lead_in(config: Config) -> float:
    """s from when the lab sees every drive enabled, which is when its script begins, to ACTIVE."""
    sequence = config.control.sequence
    return (
        sequence.referencing_settle_s
        + sequence.referencing_average_s
        + sequence.pretension_s
        + sequence.lift_s
        + 1.0 / sequence.reference_slew
    )


def until_active(script: LabScript, clear: float, config: Config) -> LabScript:
    """What of ``script`` is there before ACTIVE: no load that comes later, and no phantom that the
    way from the cradle home passes at ``clear`` m or more."""
    way = np.array([config.robot.rest, config.robot.home])
    later: dict[str, Any] = {}
    if script.load is not None:
        first = script.load.profile[0]
        if first.force == 0.0 and first.at >= lead_in(config):
            later["load"] = None
    phantom = script.phantom
    if phantom is not None and clearance(phantom, way).min() >= clear:
        later["phantom"] = None
    return script.model_copy(update=later)


class Selecting(Script):
    """A script that starts one of the daemon's scenarios."""

    number = 0
    """of the scenario, from 0 on"""

    def next(self, sequence: ControlSequence) -> Operator:
        command = super().next(sequence)
        self.select = self.number + 1 if command is Operator.START else 0
        return command


class Parting:
    """Parts a run of several scenarios, which differ in the reference, the duration, and a load and
    a phantom that come with ACTIVE, into one run each."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        shared: LabScript,
        script: Selecting,
        lost: Callable[[int, int], None],
        began: Callable[[], None] = lambda: None,
    ) -> None:
        """``shared``: what is there before ACTIVE. ``lost`` is called with the number of a scenario
        whose process died, and its exit code; ``began`` in each process that takes one up."""
        self.left = list(range(len(scenarios)))
        """numbers of the scenarios that this process plays, or has played"""
        self._scenarios, self._shared, self._script = scenarios, shared, script
        self._lost, self._began = lost, began
        self._parts: tuple[Daemon, Lab, Callable[[], NDArray[Any]]] | None = None

    def of(self, daemon: Daemon, lab: Lab, way: Callable[[], NDArray[Any]]) -> None:
        """The run to be parted; ``way`` gives the positions (n, 3) of the platform so far."""
        self._parts = daemon, lab, way

    def before_tick(self) -> None:
        """Part before the tick that starts: it is HOLD's second."""
        assert self._parts is not None
        sequence = self._parts[0].cycle.sequence
        if len(self.left) > 1 and sequence.state is _HOLD and sequence.elapsed > 0.0:
            self._part()

    def _part(self) -> None:
        """A process for each scenario, one after the other; the last one's is this one."""
        *others, last = self.left
        for number in others:
            sys.stdout.flush()
            sys.stderr.flush()
            process = clock.fork()
            if process == 0:
                die_with_parent()
                self._take_up(number)
                return
            _, status = os.waitpid(process, 0)
            code = os.waitstatus_to_exitcode(status)
            if code:
                self._lost(number, code)
        self._take_up(last)

    def _take_up(self, number: int) -> None:
        assert self._parts is not None
        daemon, lab, way = self._parts
        scenario = self._scenarios[number]
        self.left = [number]
        self._began()
        self._script.number = number
        self._script.last(scenario.duration)
        daemon.last(scenario.duration)
        load, phantom = scenario.lab.load, scenario.lab.phantom
        if load is not None and self._shared.load is None:
            lab.extend_load(load)
        if phantom is not None and self._shared.phantom is None:
            if clearance(phantom, way()).min() <= 0.0:
                raise LabError("the bring-up, which other runs share, led through the phantom")
            lab.extend_phantom(phantom)
