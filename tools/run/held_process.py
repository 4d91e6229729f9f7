"""The process of a held robot, and those it forks: one for each run."""

from __future__ import annotations

import gc
import os
import signal
import sys
import traceback
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

from tonus.config.places import RUNTIME_DIR
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
from tonus.runtime.recording.viewer import Scene
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.forking import die_with_parent
from tonus.tools.repeat import every
from tonus.tools.run import fieldbuses, provenance
from tonus.tools.run.composer import DRAIN_S
from tonus.tools.run.held_talk import Answer, Request, Said, Seen
from tonus.tools.run.late_sinks import LateSinks
from tonus.tools.run.order import Result
from tonus.tools.run.provenance import SCRIPT_START
from tonus.tools.run.ring_directory import ring_directory
from tonus.tools.run.rings import Rings
from tonus.tools.run.run_folder import LOG, RunFolder
from tonus.tools.run.supervision import supervised
from tonus.tools.run.turning import TurningPacing

_WITHIN_S = 60.0
"""s of robot time to bring the robot up"""


class HeldProcess:
    """The process of a held robot, and each of its children."""

    def __init__(
        self, config: Config, scenario: Scenario, seed: int, at: State, connection: Connection
    ) -> None:
        self._config, self._scenario, self._seed, self._at = config, scenario, seed, at
        self._connection = connection
        self._sinks = LateSinks(config.robot.cables)
        patience = config.operation.self_test.patience_s
        self._script = Script(scenario.duration, patience, (), config.control.rates.period)
        self._console = Console(self._script)
        self._running: _Running | None = None
        """in a child"""
        self._began = 0
        """in a child: number of the request that it began with"""
        self._lab: Lab | None = None
        self._daemon: Daemon | None = None
        self._attached: dict[str, bytes] = {}
        """to the log of a run with the scenario that the robot was brought up with"""

    def serve(self, theirs: Connection) -> None:
        theirs.close()
        die_with_parent()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        code = 1
        try:
            if not rehearse(self._config, self._scenario):
                raise ToolError(
                    "the control cycle does not reach ACTIVE even with an obedient robot"
                )
            outcome = clock.run(self._main(), virtual=True)
            if self._running is None:
                raise ToolError(f"the robot did not reach {self._at.name}: {outcome.reason}")
            self._running.ended(outcome)
            code = 0
        except Exception as error:  # noqa: BLE001 - whoever asked is told, whatever it is
            if not isinstance(error, ToolError | LabError | DriverError):
                traceback.print_exc()
            text = str(error) or type(error).__name__
            self._connection.send(Answer(self._began, error=text, over=True))
            code = 0
        finally:
            if self._running is not None:
                self._running.close()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

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
        with supervised(config, sinks) as ring:
            daemon = self._daemon = Daemon(
                config,
                self._scenario,
                fieldbus,
                TrackerInput(image, lab.tracker),
                self._console,
                ring=ring,
                events=sinks.event,
                stopwatch=clock.Stopwatch(running=False),
                keyframes=sinks.keyframe,
            )
            # From the start on, as in any run: a timer more may change the order of others due
            # with it.
            every(DRAIN_S, self._drain)
            pacing = fieldbuses.steering(config, fieldbus, lambda: TurningPacing(self._before_tick))
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
        self._rehearse_recording()
        # A run's collections would look through, and so copy, all that it has from here.
        gc.collect()
        gc.freeze()
        self._connection.send(Answer(0))
        while True:
            try:
                request: Request = self._connection.recv()
            except EOFError:
                os._exit(0)
            if request.kind == "close":
                os._exit(0)
            if request.kind not in ("play", "operate"):  # to one that has crashed
                continue  # which has been told
            process = clock.fork()
            if process == 0:
                die_with_parent()
                self._take_up(request)
                return
            _, status = os.waitpid(process, 0)
            code = os.waitstatus_to_exitcode(status)
            if code:
                text = f"the run's process ended without an answer ({_how(code)})"
                self._connection.send(Answer(request.number, error=text, over=True))

    def _rehearse_recording(self) -> None:
        """Record a tick and throw it away: what is made once for all logs, each run finds made. So
        is the keyframe that each of them begins with."""
        assert self._lab is not None
        assert self._daemon is not None
        with TemporaryDirectory() as folder:
            place = Path(folder)
            list(place.glob("run-*"))  # compiles the pattern, as where a run's rings lie
            rings = Rings(place, self._config, touched=False)
            rings.truth().publish(self._sinks.record, clock.now_ns())
            rings.cycles.publish(self._daemon.cycle.record.data, clock.now_ns())
            self._daemon.prepare_to_go_on()
            self._attached = provenance.attachments(self._config, self._scenario, ())
            recorder = _recorder(
                place,
                place / LOG,
                self._config,
                self._scenario,
                self._attached,
                self._seed,
                self._lab,
            )
            recorder.drain()
            recorder.finish()

    def _take_up(self, request: Request) -> None:
        assert self._lab is not None
        assert self._daemon is not None
        played = request.scenario or self._scenario
        self._began = request.number
        if request.rings is not None:
            os.environ[RUNTIME_DIR] = request.rings
        if request.scenario is None:
            self._console.script = None
        else:
            self._lab.extend_script(played.lab.faults)
            self._script.follow(played.operator)
            self._script.last(played.duration)
        usual = played is self._scenario
        self._running = _Running(
            self._config,
            played,
            self._attached if usual else provenance.attachments(self._config, played, ()),
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
        attached: dict[str, bytes],
        seed: int,
        request: Request,
        lab: Lab,
        daemon: Daemon,
        console: Console,
        sinks: LateSinks,
        connection: Connection,
    ) -> None:
        self._period = config.control.rates.period
        self._lab, self._daemon, self._console = lab, daemon, console
        self._sinks, self._connection = sinks, connection
        self._left = 0 if request.kind == "operate" else None
        """ticks until the next question; None: no end"""
        self._asked = request.number
        self._refused = ""
        self._began_ns = clock.now_ns()
        self._wall = clock.wall_seconds()
        self._cleanup = ExitStack()
        assert request.out is not None, "a run that begins has a folder"
        make_folder(request.out)
        folder = RunFolder(request.out, link=False)
        rings = self._cleanup.enter_context(ring_directory(lambda _: None))
        self._cleanup.enter_context(folder.occupied())
        sinks.open(Rings(rings, config, touched=False))
        self._log = folder.path / LOG
        self.recorder = _recorder(rings, self._log, config, scenario, attached, seed, lab)
        folder.started()

    def before_tick(self) -> None:
        if self._left is None:
            return
        while self._left == 0:
            self._connection.send(
                Answer(self._asked, error=self._refused)
                if self._refused
                else Answer(self._asked, self._seen())
            )
            self._refused = ""
            self._obey(self._connection.recv())
            if self._left is None:
                return
        self._left -= 1

    def _obey(self, request: Request) -> None:
        self._asked = request.number
        if request.kind == "advance":
            self._left = request.ticks
        elif request.kind == "finish":
            self._console.stop()
            self._left = None
        elif request.kind == "end":
            self.ended(self._daemon.outcome)
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

    def ended(self, outcome: Outcome) -> None:
        """Complete the log; answer with the result."""
        self.recorder.drain()
        self.recorder.finish()
        seconds = clock.wall_seconds() - self._wall
        result = Result(outcome, self._log, seconds, unrecorded=self.recorder.stopped)
        self._connection.send(Answer(self._asked, result, over=True))

    def close(self) -> None:
        self._cleanup.close()


def _recorder(
    rings: Path,
    log: Path,
    config: Config,
    scenario: Scenario,
    attached: dict[str, bytes],
    seed: int,
    lab: Lab,
) -> Recorder:
    metadata = {
        **provenance.metadata(config, scenario, seed=seed, virtual=True),
        **FROM_A_KEYFRAME,
        SCRIPT_START: str(lab.script_start_ns),
    }
    return Recorder(rings, log, config.recording, metadata, attached, 0, None, Scene.of(config))


def _how(code: int) -> str:
    """An exit code in words: "exit code 3", "signal SIGKILL"."""
    return f"exit code {code}" if code > 0 else f"signal {signal.Signals(-code).name}"
