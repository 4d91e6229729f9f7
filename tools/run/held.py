"""A robot brought up once, from which runs start: each is a fork of the process it stands in.

In virtual time daemon, lab and buses are one process on one loop, so that a fork is a copy of all
of them. A run that starts so is, tick for tick and bit for bit, the rest of the run that would have
been brought up for it; its log begins with a keyframe, and replays from there.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tonus.config.places import RUNTIME_DIR
from tonus.config.schema.faults import Fault
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.errors import DriverError
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.operator import Console, Script
from tonus.runtime.operation.rehearsal import rehearse
from tonus.runtime.recording.keyframe import FROM_A_KEYFRAME
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.taps import Level
from tonus.runtime.recording.viewer import Scene
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.forking import die_with_parent
from tonus.tools.repeat import every
from tonus.tools.run import fieldbuses, provenance
from tonus.tools.run.composer import DRAIN_S
from tonus.tools.run.order import Result
from tonus.tools.run.provenance import SCRIPT_START
from tonus.tools.run.ring_directory import ring_directory
from tonus.tools.run.rings import Rings
from tonus.tools.run.run_folder import LOG, RunFolder

Holding = Literal["HOLD", "ACTIVE"]
_WITHIN_S = 60.0
"""s of robot time to bring the robot up"""


class Said(NamedTuple):
    """An event."""

    time: float
    """s since the run was forked"""
    level: Level
    name: str
    where: str
    text: str


@dataclass(frozen=True)
class Seen:
    """What a held robot shows between two ticks."""

    state: State
    fault: str
    """name; NONE without one"""
    time: float
    """s since the run was forked"""
    record: NDArray[np.void]
    """(1,) the cycle record of the last tick"""
    truth: NDArray[np.void]
    """(1,) of the plant, as `/tonus/truth` has it"""
    events: tuple[Said, ...]
    """since the last look"""


@dataclass(frozen=True)
class _Request:
    kind: Literal["play", "operate", "advance", "inject", "command", "finish", "end", "close"]
    out: Path = Path()
    scenario: Scenario | None = None
    ticks: int = 0
    fault: Fault | None = None
    operator: Operator = Operator.NONE
    rings: str | None = None
    """folder for rings, as the asking process has it by now"""


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
        self.config, self.scenario = config, _undisturbed(scenario)
        context = multiprocessing.get_context("fork")
        self._connection, theirs = context.Pipe()
        held = _Held(config, self.scenario, seed, State[at], theirs)
        self._process = context.Process(target=held.serve, args=(self._connection,), daemon=True)
        self._open: HeldRun | None = None
        self._process.start()
        theirs.close()
        self._answer()

    def play(self, out: Path, scenario: Scenario | None = None) -> Result:
        """Go on to the end of a scenario, recorded in ``out``. Raises `ToolError` for a scenario
        that would have been another one before now."""
        played = scenario or self.scenario
        if _undisturbed(played) != self.scenario.model_copy(update={"duration": played.duration}):
            raise ToolError(
                f"scenario {played.name}: only faults, commands and duration may differ from "
                f"those the robot was brought up with ({self.scenario.name})"
            )
        self._need_idle()
        result = self._ask(_Request("play", out, played, rings=os.environ.get(RUNTIME_DIR)))
        assert isinstance(result, Result)
        return result

    @contextmanager
    def operated(self, out: Path) -> Iterator[HeldRun]:
        """A run that is advanced step by step, recorded in ``out``; it ends with the block. Raises
        `ToolError` while another is open."""
        self._need_idle()
        first = self._ask(_Request("operate", out, rings=os.environ.get(RUNTIME_DIR)))
        assert isinstance(first, Seen)
        run = self._open = HeldRun(self._ask, first, self.config.control.rates.period)
        try:
            yield run
        finally:
            run.end()

    def close(self) -> None:
        """The process ends, and what it holds is gone. Does nothing a second time."""
        if self._open is not None:
            with suppress(ToolError):  # of one that has crashed
                self._open.end()
        with suppress(OSError):  # of one that has ended by itself, or is closed
            # It would not see the end of the pipe, which later robots' processes inherit.
            self._connection.send(_Request("close"))
        self._connection.close()
        self._process.join()

    def _need_idle(self) -> None:
        if self._open is not None and self._open.result is None:
            raise ToolError("a held robot plays one run at a time; end the other one first")

    def _ask(self, request: _Request) -> Result | Seen | None:
        self._connection.send(request)
        return self._answer()

    def _answer(self) -> Result | Seen | None:
        try:
            answer: Result | Seen | str | None = self._connection.recv()
        except EOFError:
            raise ToolError("the held robot's process ended without an answer") from None
        if isinstance(answer, str):
            raise ToolError(answer)
        return answer


class HeldRun:
    """One run from a held robot. Nothing happens but in `advance`."""

    def __init__(
        self,
        ask: Callable[[_Request], Result | Seen | None],
        first: Seen,
        period: float,
    ) -> None:
        self._ask, self._period = ask, period
        self.seen = first
        self.result: Result | None = None
        """once it has ended"""

    def advance(self, seconds: float) -> Seen:
        """So much robot time, in whole ticks. Less where the run ends before."""
        self._need()
        answer = self._ask(_Request("advance", ticks=round(seconds / self._period)))
        if isinstance(answer, Seen):
            self.seen = answer
        else:
            self.result = answer
        return self.seen

    def inject(self, fault: Fault) -> None:
        """Now, or ``fault.at`` s from now. Raises `ToolError` where the lab cannot."""
        self._need()
        self._ask(_Request("inject", fault=fault))

    def command(self, operator: Operator) -> None:
        """What the next tick is to be told."""
        self._need()
        self._ask(_Request("command", operator=operator))

    def finish(self) -> Result:
        """A controlled stop, to STANDBY or FAULT."""
        return self._over("finish")

    def end(self) -> Result:
        """Stop recording here and leave the robot as it is. Does nothing to a run that is over."""
        return self._over("end")

    def _over(self, kind: Literal["finish", "end"]) -> Result:
        if self.result is None:
            answer = self._ask(_Request(kind))
            assert isinstance(answer, Result)
            self.result = answer
        return self.result

    def _need(self) -> None:
        if self.result is not None:
            raise ToolError("the run is over; begin another from the held robot")


def _undisturbed(scenario: Scenario) -> Scenario:
    script = scenario.lab.model_copy(update={"faults": ()})
    return scenario.model_copy(update={"lab": script, "operator": ()})


class _Sinks:
    """What daemon and lab write goes nowhere, until there are rings for it."""

    def __init__(self, cables: int) -> None:
        self.rings: Rings | None = None
        self.record = np.zeros(1, truth_dtype(cables))
        self.events: list[tuple[int, Level, str, str, str]] = []
        self._truth: Callable[[NDArray[np.void], int], None] | None = None

    def open(self, rings: Rings) -> None:
        self.rings, self._truth = rings, rings.truth().publish

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None:
        if self.rings is not None:
            self.rings.cycles.publish(payload, stamp_ns)

    def truth(self, record: NDArray[np.void], stamp_ns: int) -> None:
        self.record[...] = record
        if self._truth is not None:
            self._truth(record, stamp_ns)

    def event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str = "", text: str = ""
    ) -> None:
        if self.rings is not None:
            self.events.append((stamp_ns, level, name, where, text))
            self.rings.events.write(stamp_ns, tick, level, name, where, text)

    def keyframe(self, stamp_ns: int, tick: int, state: bytes) -> None:
        if self.rings is not None:
            self.rings.keyframes.write(stamp_ns, tick, state)

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        if self.rings is not None and self.rings.frames is not None:
            self.rings.frames.frame(stamp_ns, channel, identifier, data, sent=sent)

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        if self.rings is not None and self.rings.frames is not None:
            self.rings.frames.received(frames, channel, now_ns)


class _Turning(VirtualPacing):
    def __init__(self, turn: Callable[[], None]) -> None:
        self._turn = turn

    async def until(self, due_ns: int) -> None:
        self._turn()
        await super().until(due_ns)


class _Held:
    """The process of a held robot, and each of its children."""

    def __init__(
        self, config: Config, scenario: Scenario, seed: int, at: State, connection: Connection
    ) -> None:
        self._config, self._scenario, self._seed, self._at = config, scenario, seed, at
        self._connection = connection
        self._sinks = _Sinks(config.robot.cables)
        self._script = Script(scenario.duration, 0.0, (), config.control.rates.period)
        self._console = Console(self._script)
        self._running: _Running | None = None
        """in a child"""
        self._lab: Lab | None = None
        self._daemon: Daemon | None = None

    def serve(self, theirs: Connection) -> None:
        theirs.close()
        die_with_parent()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        try:
            if not rehearse(self._config, self._scenario):
                raise ToolError(
                    "the control cycle does not reach ACTIVE even with an obedient robot"
                )
            outcome = clock.run(self._main(), virtual=True)
            if self._running is None:
                raise ToolError(f"the robot did not reach {self._at.name}: {outcome.reason}")
            self._connection.send(self._running.result(outcome))
        except Exception as error:  # noqa: BLE001 - whoever asked is told, whatever it is
            if not isinstance(error, ToolError | LabError | DriverError):
                traceback.print_exc()
            self._connection.send(str(error) or type(error).__name__)
        finally:
            if self._running is not None:
                self._running.close()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)

    async def _main(self) -> Outcome:
        config, sinks = self._config, self._sinks
        image = ProcessImage(config.robot.cables)
        lab = self._lab = Lab(
            config,
            self._scenario.lab,
            seed=self._seed,
            clock=clock.loop_clock(),
            truth=sinks.truth,
        )
        lab.open()
        fieldbus = fieldbuses.build(config, image, lab, sinks)
        daemon = self._daemon = Daemon(
            config,
            self._scenario,
            fieldbus,
            TrackerInput(image, lab.tracker),
            self._console,
            ring=sinks,
            events=sinks.event,
            stopwatch=clock.Stopwatch(running=False),
            keyframes=sinks.keyframe,
        )
        # From the start on, as in any run: a timer more may change the order of others due with it.
        every(DRAIN_S, self._drain)
        pacing = fieldbuses.steering(config, fieldbus, lambda: _Turning(self._before_tick))
        return await daemon.run(pacing, lambda _: None, lambda: None)

    def _drain(self) -> None:
        if self._running is not None:
            self._running.recorder.drain()

    def _before_tick(self) -> None:
        assert self._daemon is not None
        sequence = self._daemon.cycle.sequence
        if self._running is not None:
            self._running.before_tick()
        elif sequence.state is self._at and sequence.elapsed > 0.0:
            self._stand()
        elif clock.now_ns() > 1e9 * _WITHIN_S:
            raise ToolError(f"the robot did not reach {self._at.name} in {_WITHIN_S:g} s")

    def _stand(self) -> None:
        """In the parent for ever; in a child once there is one."""
        self._connection.send(None)
        while True:
            try:
                request: _Request = self._connection.recv()
            except EOFError:
                os._exit(0)
            if request.kind == "close":
                os._exit(0)
            if request.kind not in ("play", "operate"):  # to one that has crashed
                self._connection.send("the run is over; begin another from the held robot")
                continue
            process = clock.fork()
            if process == 0:
                die_with_parent()
                self._take_up(request)
                return
            _, status = os.waitpid(process, 0)
            code = os.waitstatus_to_exitcode(status)
            if code:
                self._connection.send(f"the run ended without an answer (exit code {code})")

    def _take_up(self, request: _Request) -> None:
        assert self._lab is not None
        assert self._daemon is not None
        played = request.scenario or self._scenario
        if request.rings is not None:
            os.environ[RUNTIME_DIR] = request.rings
        if request.scenario is None:
            self._console.script = None
        else:
            self._lab.extend_script(played.lab.faults)
            self._script.follow(played.operator)
            self._script.last(played.duration)
        self._running = _Running(
            self._config,
            played,
            self._seed,
            request,
            self._lab,
            self._daemon,
            self._console,
            self._sinks,
            self._connection,
        )
        self._daemon.go_on(played.duration)
        self._running.before_tick()


class _Running:
    """A child: its recording, and how far it may go."""

    def __init__(
        self,
        config: Config,
        scenario: Scenario,
        seed: int,
        request: _Request,
        lab: Lab,
        daemon: Daemon,
        console: Console,
        sinks: _Sinks,
        connection: Connection,
    ) -> None:
        self._period = config.control.rates.period
        self._lab, self._daemon, self._console = lab, daemon, console
        self._sinks, self._connection = sinks, connection
        self._left = 0 if request.kind == "operate" else None
        """ticks until the next question; None: no end"""
        self._refused = ""
        self._began_ns = clock.now_ns()
        self._wall = clock.wall_seconds()
        self._cleanup = ExitStack()
        make_folder(request.out)
        folder = RunFolder(request.out, link=False)
        rings = self._cleanup.enter_context(ring_directory(lambda _: None))
        self._cleanup.enter_context(folder.occupied())
        sinks.open(Rings(rings, config))
        self._log = folder.path / LOG
        self.recorder = Recorder(
            rings,
            self._log,
            config.recording,
            {
                **provenance.metadata(config, scenario, seed=seed, virtual=True),
                **FROM_A_KEYFRAME,
                SCRIPT_START: str(lab.script_start_ns),
            },
            provenance.attachments(config, scenario, ()),
            0,
            None,
            Scene.of(config),
        )
        folder.started()

    def before_tick(self) -> None:
        if self._left is None:
            return
        while self._left == 0:
            self._connection.send(self._refused or self._seen())
            self._refused = ""
            self._obey(self._connection.recv())
            if self._left is None:
                return
        self._left -= 1

    def _obey(self, request: _Request) -> None:
        if request.kind == "advance":
            self._left = request.ticks
        elif request.kind == "finish":
            self._console.stop()
            self._left = None
        elif request.kind == "end":
            self._connection.send(self.result(self._daemon.outcome))
            self.close()
            os._exit(0)
        elif request.fault is not None:
            try:
                self._lab.inject(request.fault)
            except LabError as error:
                self._refused = str(error)
        else:
            self._console.give(request.operator, "held")

    def _seen(self) -> Seen:
        sequence = self._daemon.cycle.sequence
        events = tuple(
            Said((stamp_ns - self._began_ns) * 1e-9, level, name, where, text)
            for stamp_ns, level, name, where, text in self._sinks.events
        )
        self._sinks.events.clear()
        return Seen(
            sequence.state,
            sequence.fault.name,
            (clock.now_ns() - self._began_ns) * 1e-9,
            self._daemon.cycle.record.data.copy(),
            self._sinks.record.copy(),
            events,
        )

    def result(self, outcome: Outcome) -> Result:
        self.recorder.drain()
        self.recorder.finish()
        seconds = clock.wall_seconds() - self._wall
        return Result(outcome, self._log, seconds, unrecorded=self.recorder.stopped)

    def close(self) -> None:
        self._cleanup.close()
