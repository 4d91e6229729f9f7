"""Whatever faults, commands and times a test gives to the plugin's runs: no run does what
`Run.invariants` does not accept.

A short form in `make test-wide`; `make test-long` has the shipped robots and more examples, and
replays every run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
from loop import QUICK

from tonus.config.loader import load_scenario
from tonus.config.schema.scenario import Command
from tonus.tools.testing.case import Case
from tonus.tools.testing.player import Player

HERE = Path(__file__).resolve()
FAULTS_OF_AXES: dict[str, dict[str, Any]] = {
    "cable_cut": {},
    "drum_jam": {},
    "motor_weak": {"gain": 0.5},
    "encoder_frozen": {},
}
FAULTS_OF_CELLS: dict[str, dict[str, Any]] = {"cell_frozen": {}, "cell_offset": {"force": 20.0}}
FAULTS: dict[str, dict[str, Any]] = {
    "tracker_hidden": {"duration": 0.3},
    "load": {"force": [30.0, 0.0, 0.0], "duration": 0.3},
}
FAULTS_OF_NODES = ("unplug", "power_cycle")
MOST_FAULTS = 2
"""as in the fault campaign: what three at once may do no rule says"""
ENDING = ("stop", "estop")


class Uses(RuleBasedStateMachine):
    """Draws one run, step by step, and plays it in the end."""

    configs: ClassVar[tuple[str, ...]] = ("config/direct.yaml",)
    replayed: ClassVar[bool] = False

    @initialize(data=st.data(), seed=st.integers(1, 1000))
    def start(self, data: st.DataObject, seed: int) -> None:
        self.config, self.seed = data.draw(st.sampled_from(self.configs)), seed
        self.now = 2.5  # s: the quick bring-up is about to end
        self.faults: list[dict[str, Any]] = []
        self.commands: list[Command] = []

    @rule(ms=st.sampled_from([1, 7, 40, 250]))
    def wait(self, ms: int) -> None:
        self.now += 1e-3 * ms

    @precondition(lambda self: len(self.faults) < MOST_FAULTS)
    @rule(kind=st.sampled_from(sorted(FAULTS_OF_AXES)), axis=st.integers(0, 5))
    def fault_of_an_axis(self, kind: str, axis: int) -> None:
        self._fault(kind=kind, axis=axis, **FAULTS_OF_AXES[kind])

    @precondition(lambda self: len(self.faults) < MOST_FAULTS)
    @rule(kind=st.sampled_from(sorted(FAULTS_OF_CELLS)), cell=st.integers(0, 5))
    def fault_of_a_cell(self, kind: str, cell: int) -> None:
        self._fault(kind=kind, cell=cell, **FAULTS_OF_CELLS[kind])

    @precondition(lambda self: len(self.faults) < MOST_FAULTS)
    @rule(kind=st.sampled_from(sorted(FAULTS)))
    def fault(self, kind: str) -> None:
        self._fault(kind=kind, **FAULTS[kind])

    @precondition(lambda self: len(self.faults) < MOST_FAULTS and "direct" not in self.config)
    @rule(kind=st.sampled_from(FAULTS_OF_NODES), node=st.sampled_from((1, 7)))
    def fault_of_a_node(self, kind: str, node: int) -> None:
        self._fault(kind=kind, channel="can0", node=node)

    @precondition(lambda self: not self.commands or self.commands[-1].command not in ENDING)
    @rule(command=st.sampled_from(["start", "hold", *ENDING]))
    def command(self, command: Any) -> None:
        self.commands.append(Command(at=self.now, command=command))

    def _fault(self, **fields: Any) -> None:
        # The campaign's pairs are of different kinds; two torn cables may be faster than the bound,
        # for which config/least_stop.yaml has single tears only.
        if all(fields["kind"] != each["kind"] for each in self.faults):
            self.faults.append({**fields, "at": self.now})

    def teardown(self) -> None:
        case = Case(
            "any use",
            file=HERE,
            root=HERE.parent,
            invoked=HERE.parent,
            out=HERE.parent,
            config=self.config,
            overrides=QUICK,
            seed=self.seed,
        )
        try:
            hold = load_scenario("hold").model_copy(update={"operator": tuple(self.commands)})
            run = Player(case)(hold, faults=self.faults, duration=0.3)
            told = f"{self.config}, seed {self.seed}, {self.faults}, {self.commands}"
            assert run.state in ("STANDBY", "FAULT"), told
            run.invariants(replayed=self.replayed)
        finally:
            case.close()


class OnEveryRobot(Uses):
    configs = (
        *("config/direct.yaml", "config/can.yaml", "config/six.yaml", "config/seven.yaml"),
        *("config/twelve.yaml", "config/unlike_axes.yaml"),
    )
    replayed = True


def played(machine: type[Uses], examples: int, steps: int) -> None:
    chosen = settings(
        max_examples=examples,
        stateful_step_count=steps,
        derandomize=True,
        deadline=None,
        phases=[Phase.generate],
    )
    run_state_machine_as_test(machine, settings=chosen)


@pytest.mark.wide
def test_any_use_of_the_plugin() -> None:
    played(Uses, 2, 8)


@pytest.mark.long
def test_any_use_on_every_robot() -> None:
    played(OnEveryRobot, 60, 12)
