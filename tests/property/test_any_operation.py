"""Any sequence of commands, faults and signals through the control socket: no transition that the
table does not have, nothing armed without a self-test, an emergency stop within a tick."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from operated import NAMES, Operated
from statue import CONTROL

from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.states import ARMED, MOVES, State

REACHES = {(state, move.to) for (state, _), move in MOVES.items()}
STALE = CONTROL.freshness.stale_stop_ticks


def silent_drive(image: ProcessImage) -> None:
    image.axes["age"][3] = STALE + 1


def failed_drive(image: ProcessImage) -> None:
    image.axes["state"][6] = AxisState.FAULT


def quick_stopped_drive(image: ProcessImage) -> None:
    image.axes["state"][1] = AxisState.QUICK_STOP_ACTIVE


def silent_cell(image: ProcessImage) -> None:
    image.cells["age"][8] = STALE + 1


def broken_cell(image: ProcessImage) -> None:
    image.cells["status"][0] = 1


def impossible_cell(image: ProcessImage) -> None:
    image.cells["force"][5] = np.nan


def contact(image: ProcessImage) -> None:
    image.cells["force"][8] = 40.0


def hidden_platform(image: ProcessImage) -> None:
    image.tracker["fresh"], image.tracker["delay"] = 0, 1.0


TROUBLES = {
    spoil.__name__: spoil
    for spoil in (
        *(silent_drive, failed_drive, quick_stopped_drive, silent_cell, broken_cell),
        *(impossible_cell, contact, hidden_platform),
    )
}
ONLY_UNFIT = (quick_stopped_drive, hidden_platform)
COMMANDS = ("arm", "start", "hold", "stop", "reset")


class AnyOperation(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.robot = Operated(Path(self.folder.name))
        self.seen = 0
        self.unfit: dict[int, bool] = {}
        """whether something stood against arming in a tick: the self-test's word, and our own"""
        self.troubled = 0
        """ticks in a row with a trouble that is no fault while disarmed"""
        test = self.robot.daemon.self_test
        self.robot.daemon.serve("watch", self._watched(test))
        self.robot.advance(2)

    def _watched(self, test: Any) -> Any:
        def watch(due_ns: int) -> None:
            if self.robot.history:
                tick = self.robot.history[-1].tick
                there = any(spoil in ONLY_UNFIT for spoil in self.robot.bus.spoils)
                self.troubled = self.troubled + 1 if there else 0
                old = self.troubled > self.robot.config.operation.self_test.maximum_age_ms
                self.unfit[tick + 1] = old or bool(test.obstacles(tick + 1))

        return watch

    @property
    def running(self) -> bool:
        return self.robot.outcome is None

    @precondition(lambda self: self.running)
    @rule(op=st.sampled_from(COMMANDS), ticks=st.integers(3, 12))
    def command(self, op: str, ticks: int) -> None:
        reply = self.robot.command(op, ticks)
        assert reply["ok"] or (reply["error"] and reply["next"]), reply

    @precondition(lambda self: self.running)
    @rule(name=st.sampled_from((*NAMES, "nope")))
    def choose(self, name: str) -> None:
        self.robot.command("scenario", name=name)

    @precondition(lambda self: self.running)
    @rule()
    def emergency_stop(self) -> None:
        handled = len(self.robot.history)
        assert self.robot.command("estop", 3)["ok"]
        # Sent between two ticks: heard after the next one, and done in the one after that.
        after = self.robot.history[handled + 1]
        assert after.state is State.FAULT
        assert not after.enabled

    @precondition(lambda self: self.running)
    @rule(ticks=st.sampled_from((1, 5, 40, 200)))
    def wait(self, ticks: int) -> None:
        self.robot.advance(ticks)

    @precondition(lambda self: self.running)
    @rule(name=st.sampled_from(sorted(TROUBLES)), ticks=st.sampled_from((1, 30)))
    def trouble(self, name: str, ticks: int) -> None:
        self.robot.bus.spoils.append(TROUBLES[name])
        self.robot.advance(ticks)

    @precondition(lambda self: self.running and self.robot.state is State.STANDBY)
    @rule(spoil=st.sampled_from(ONLY_UNFIT))
    def arm_the_unfit(self, spoil: Any) -> None:
        """What random steps seldom come to."""
        self.robot.bus.spoils.append(spoil)
        self.robot.advance(20)
        self.robot.command("arm")

    @rule()
    def mended(self) -> None:
        self.robot.bus.spoils.clear()

    @precondition(lambda self: self.running and self.robot.state in ARMED)
    @rule(times=st.sampled_from((1, 2)))
    def signal(self, times: int) -> None:
        for _ in range(times):
            self.robot.console.stop("signal SIGTERM")
        self.robot.advance(5)

    @precondition(lambda self: self.running)
    @rule(data=st.binary(max_size=40))
    def noise(self, data: bytes) -> None:
        self.robot.client.send(data + b"\n")
        self.robot.advance(2 + data.count(b"\n"))
        assert not any(reply["ok"] for reply in self.robot.client.replies())

    @invariant()
    def every_transition_is_in_the_table(self) -> None:
        history, seen = self.robot.history, self.seen
        for before, after in zip(history[seen:], history[seen + 1 :], strict=False):
            if after.state is not before.state:
                assert (before.state, after.state) in REACHES, (before, after)
            if after.state is State.REFERENCING and before.state is not State.REFERENCING:
                assert not self.unfit[after.tick], f"armed in tick {after.tick} without a self-test"
            if after.state not in ARMED:
                assert not after.enabled, after
        self.seen = max(len(history) - 1, 0)

    @invariant()
    def an_end_is_at_rest(self) -> None:
        if not self.running:
            assert self.robot.state not in ARMED

    def teardown(self) -> None:
        self.robot.close()
        self.folder.cleanup()


def test_any_operation() -> None:
    run_state_machine_as_test(
        AnyOperation,
        settings=settings(max_examples=15, stateful_step_count=30, deadline=None, derandomize=True),
    )
