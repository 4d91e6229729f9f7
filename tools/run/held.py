"""A robot brought up once, from which runs start: each is a fork of the process it stands in.

In virtual time daemon, lab and buses are one process on one loop, so that a fork is a copy of all
of them. A run that starts so is, tick for tick and bit for bit, the rest of the run that would have
been brought up for it; its log begins with a keyframe, and replays from there.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tonus.config.places import RUNTIME_DIR
from tonus.config.schema.faults import Fault
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.states import Operator, State
from tonus.tools.errors import ToolError
from tonus.tools.run.held_process import HeldProcess
from tonus.tools.run.held_talk import Answer, Request, Seen
from tonus.tools.run.order import Result

Holding = Literal["HOLD", "ACTIVE"]
_GONE = "the held robot's process has ended; bring up another"


class RunOverError(ToolError):
    """The run has ended without a result: its process has crashed, or refused to begin."""


class HeldRobot:
    """Brings the robot of ``config`` up to HOLD or ACTIVE, in a process of its own, and keeps it
    there until `close`.

    Raises `ToolError` with the reason where it does not come up.
    """

    def __init__(
        self, config: Config, scenario: Scenario, *, seed: int = 1, at: Holding = "HOLD"
    ) -> None:
        """``scenario``: what runs may play from here, with faults, commands and durations of their
        own."""
        if config.lab is None:
            raise ToolError("virtual time needs a lab: section in the configuration")
        self.config, self.scenario = config, undisturbed(scenario)
        context = multiprocessing.get_context("fork")
        self._connection, theirs = context.Pipe()
        held = HeldProcess(config, self.scenario, seed, State[at], theirs)
        self._process = context.Process(target=held.serve, args=(self._connection,), daemon=True)
        self._open: HeldRun | None = None
        self._number = self._first = 0
        """of the last request, and of the one that the last run began with"""
        self._process.start()
        theirs.close()
        self._answer()

    def play(self, out: Path, scenario: Scenario | None = None) -> Result:
        """Go on to the end of a scenario, recorded in ``out``. Raises `ToolError` for a scenario
        that would have been another one before now."""
        played = scenario or self.scenario
        if undisturbed(played) != self.scenario.model_copy(update={"duration": played.duration}):
            raise ToolError(
                f"scenario {played.name}: only faults, commands and duration may differ from "
                f"those the robot was brought up with ({self.scenario.name})"
            )
        self._need_idle()
        result = self._begin(Request("play", out, played, rings=os.environ.get(RUNTIME_DIR)))
        assert isinstance(result, Result)
        return result

    @contextmanager
    def operated(self, out: Path) -> Iterator[HeldRun]:
        """A run that is advanced step by step, recorded in ``out``; it ends with the block. Raises
        `ToolError` while another is open."""
        self._need_idle()
        first = self._begin(Request("operate", out, rings=os.environ.get(RUNTIME_DIR)))
        assert isinstance(first, Seen)
        run = self._open = HeldRun(self._ask, first, self.config.control.rates.period)
        try:
            yield run
        finally:
            if not run.over:
                run.end()

    @property
    def alive(self) -> bool:
        """Whether runs can start from it."""
        return self._process.is_alive()

    def close(self) -> None:
        """The process ends, and what it holds is gone. Does nothing a second time."""
        if self._open is not None and not self._open.over:
            with suppress(ToolError):  # of one that has crashed
                self._open.end()
        with suppress(OSError):  # of one that has ended by itself, or is closed
            # It would not see the end of the pipe, which later robots' processes inherit.
            self._connection.send(Request("close"))
        self._connection.close()
        self._process.join()

    def _need_idle(self) -> None:
        if self._open is not None and not self._open.over:
            raise ToolError("a held robot plays one run at a time; end the other one first")

    def _begin(self, request: Request) -> Result | Seen | None:
        self._first = self._number + 1
        return self._ask(request).value

    def _ask(self, request: Request) -> Answer:
        """Raises `RunOverError` where the run ends without a result, else `ToolError`."""
        self._number += 1
        try:
            self._connection.send(replace(request, number=self._number))
        except OSError:
            raise RunOverError(_GONE) from None
        return self._answer()

    def _answer(self) -> Answer:
        while True:
            try:
                answer: Answer = self._connection.recv()
            except (EOFError, OSError):
                raise RunOverError(_GONE) from None
            if answer.over and answer.error and answer.number == self._first:
                raise RunOverError(answer.error)
            if answer.number != self._number:
                continue  # of a run that crashed when it had answered its last request
            if answer.error:
                raise ToolError(answer.error)
            return answer


class HeldRun:
    """One run from a held robot. Nothing happens but in `advance`."""

    def __init__(self, ask: Callable[[Request], Answer], first: Seen, period: float) -> None:
        self._send, self._period = ask, period
        self.seen = first
        self.over = False
        self.result: Result | None = None
        """once it is over, unless it has crashed"""

    def advance(self, seconds: float) -> Seen:
        """So much robot time, in whole ticks. Less where the run ends before. Raises
        `ToolError`."""
        self._need()
        if not 0.0 <= seconds < math.inf:
            raise ToolError(f"advance: {seconds:g} s is not possible; choose a time from 0 on")
        answer = self._ask(Request("advance", ticks=round(seconds / self._period)))
        if isinstance(answer, Seen):
            self.seen = answer
        return self.seen

    def inject(self, fault: Fault) -> None:
        """Now, or ``fault.at`` s from now. Raises `ToolError` where the lab cannot."""
        self._need()
        self._ask(Request("inject", fault=fault))

    def command(self, operator: Operator) -> None:
        """What the next tick is to be told."""
        self._need()
        self._ask(Request("command", operator=operator))

    def finish(self) -> Result:
        """A controlled stop, to STANDBY or FAULT. Raises `ToolError` for a run that has
        crashed."""
        return self._ended("finish")

    def end(self) -> Result:
        """Stop recording here and leave the robot as it is. Does nothing to a run that is over.
        Raises `ToolError` for one that has crashed."""
        return self._ended("end")

    def _ended(self, kind: Literal["finish", "end"]) -> Result:
        if self.result is None:
            self._need()
            self._ask(Request(kind))
        assert self.result is not None, "an answer that ends a run has its result"
        return self.result

    def _ask(self, request: Request) -> Result | Seen | None:
        try:
            answer = self._send(request)
        except RunOverError:
            self.over = True
            raise
        if isinstance(answer.value, Result):
            self.over, self.result = True, answer.value
        return answer.value

    def _need(self) -> None:
        if self.over:
            raise ToolError("the run is over; begin another from the held robot")


def undisturbed(scenario: Scenario) -> Scenario:
    """Without faults and commands."""
    script = scenario.lab.model_copy(update={"faults": ()})
    return scenario.model_copy(update={"lab": script, "operator": ()})
