"""What the cycle is told in each tick: the operator's word, as self-test, overrun policy and a
recovery of the bus let it pass."""

from __future__ import annotations

import asyncio
from typing import Protocol

from tonus.drivers.fieldbus import Fieldbus
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.operation.operator import Commander
from tonus.runtime.operation.self_test import SelfTest
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Operator, State
from tonus.runtime.timing.overruns import Overruns
from tonus.runtime.timing.scheduler import Scheduler


class Emit(Protocol):
    """Takes an event of a tick."""

    def __call__(self, tick: int, level: Level, name: str, where: str, text: str) -> None: ...


class Orders:
    """Asked once a tick, before it."""

    def __init__(
        self,
        commander: Commander,
        sequence: Sequence,
        self_test: SelfTest,
        overruns: Overruns,
        fieldbus: Fieldbus,
        emit: Emit,
    ) -> None:
        self._commander, self._sequence = commander, sequence
        self._self_test, self._overruns = self_test, overruns
        self._fieldbus, self._emit = fieldbus, emit
        self.select = 0
        """number plus one of the scenario that the last command came with, 0 for none"""
        self.change: GainChange = NO_CHANGE
        """of a tunable parameter that the last command came with"""
        self.who = ""
        """gave the last command; empty for the program itself"""
        self._recovery: asyncio.Task[None] | None = None
        self._refused = self._resetting_for = ""

    @property
    def recovering(self) -> bool:
        """A reset waits for devices that are being brought back."""
        return self._recovery is not None

    def next(self, tick: int, scheduler: Scheduler) -> Operator:
        """What the operator says, or the overrun policy in their place."""
        self.select, self.change = 0, NO_CHANGE
        said = self._operator(tick)
        self.select, self.change = self._commander.select, self._commander.change
        if not scheduler.skipped:
            return said
        command = self._overruns.answer(scheduler.skipped, self._sequence.state, said)
        if command is not said:
            misses = scheduler.misses
            text = (
                f"{scheduler.skipped} ticks missed at once ({misses.own} own so far, "
                f"{misses.host} by the host); realtime.overrun: {command.name.lower()}"
            )
            self._emit(tick, Level.WARNING, "overrun", "scheduler", text)
        return command

    def give_up_recovery(self) -> None:
        """The reset that waits for it is forgotten."""
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None

    def _operator(self, tick: int) -> Operator:
        """What the operator says. Arming needs a good self-test, and no obstacle on the bus since
        then. A reset in FAULT waits, while ticks go on, until the bus has brought back what it can;
        an emergency stop ends that wait and the reset with it."""
        command = self._commander.next(self._sequence)
        self.who = self._commander.who
        if command is Operator.ARM and self._sequence.state is State.STANDBY:
            obstacles = self._self_test.obstacles(tick) or [
                f"{item}: {text}" for item, text in self._fieldbus.image.obstacles.items()
            ]
            if obstacles:
                self._refuse(tick, "; ".join(obstacles))
                return Operator.NONE
            self._refused = ""
        if self._recovery is None:
            if command is not Operator.RESET or self._sequence.state is not State.FAULT:
                return command
            self._resetting_for = self._commander.who
            loop = asyncio.get_running_loop()
            self._recovery = loop.create_task(self._fieldbus.recover())
            return Operator.NONE
        if command is Operator.ESTOP:
            self.give_up_recovery()
            return command
        if not self._recovery.done():
            return Operator.NONE
        recovery, self._recovery = self._recovery, None
        recovery.result()
        self.who = self._resetting_for
        return Operator.RESET

    def _refuse(self, tick: int, reason: str) -> None:
        """Whoever asks again for the same reason is answered, and the log spared."""
        self._commander.refused(reason)
        if reason != self._refused:
            self._refused = reason
            who = self._commander.who
            text = f"arm{f' by {who}' if who else ''}: {reason}"
            self._emit(tick, Level.WARNING, "refused", "", text)
