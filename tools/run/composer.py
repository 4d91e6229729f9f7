"""One run, composed: a daemon, a recorder, and a lab where the configuration has one.

The only place that puts a runtime and a lab together. In virtual time all three share one loop; in
real time each is a process of its own.
"""

from __future__ import annotations

import json
import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from tonus.config.places import LAB_DOOR, runtime_dir
from tonus.drivers.devices.tracker import TrackerInput, TrackerSource, UdpTracker
from tonus.drivers.events import EventLog
from tonus.drivers.fieldbus import Fieldbus, FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.control_door import ControlDoor
from tonus.runtime.operation.control_socket import ControlSocket, ControlSocketError
from tonus.runtime.operation.notify import Notifier
from tonus.runtime.operation.operator import Console, Script
from tonus.runtime.operation.rehearsal import rehearse
from tonus.runtime.ports import Ring
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.taps import KEYFRAME_BYTES, Level
from tonus.runtime.recording.viewer import Scene
from tonus.runtime.safety.firewall import Firewall
from tonus.runtime.safety.guarded_tap import GuardedTap
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.runtime.timing.latencies import Latencies
from tonus.runtime.timing.realtime import Hygiene, compared, demand, settled, stolen_jiffies
from tonus.runtime.timing.scheduler import Pacing, TimerPacing, VirtualPacing
from tonus.sim.lab.door import Door
from tonus.sim.lab.door_socket import DoorSocket, remove_stale
from tonus.sim.lab.engine import Lab
from tonus.tools import output
from tonus.tools.cli.live import Live
from tonus.tools.doctor import doctor
from tonus.tools.errors import ToolError
from tonus.tools.event_lines import EventLines, for_journal
from tonus.tools.folders import make_folder
from tonus.tools.repeat import every
from tonus.tools.run import fieldbuses, provenance, tracker_address
from tonus.tools.run.child_process import ChildProcess
from tonus.tools.run.description import Description, describe_run
from tonus.tools.run.idle_pacing import IdlePacing
from tonus.tools.run.lab_process import RELEASE, start_lab
from tonus.tools.run.order import Order, Result
from tonus.tools.run.recorder_process import RecorderProcess, start
from tonus.tools.run.release import releasing
from tonus.tools.run.ring_directory import ring_directory
from tonus.tools.run.rings import Rings
from tonus.tools.run.run_folder import LOG, RunFolder
from tonus.tools.run.stall_watch_process import stall_watch
from tonus.tools.run.supervision import supervised
from tonus.tools.run.supervisor_process import bridged_where_alone, supervisor_of

__all__ = ["Order", "Result", "run"]

DRAIN_S = 0.2
"""s of virtual time between two looks of the in-process recorder"""
_DISARMED = frozenset({State.OFF, State.STANDBY, State.FAULT})


def run(order: Order) -> Result:
    """Carry out a run to its end.

    Raises `ToolError` for an order that cannot be carried out, `LabError` for a lab that cannot be
    built, `DriverError` when a bus cannot be brought up. A fault during the run raises nothing: it
    is in `Result.outcome`.
    """
    for bus in order.config.fieldbus.parts:
        if bus.virtual_only and not order.virtual:
            raise ToolError(
                f"the {bus.kind} fieldbus needs virtual time and a lab: add --virtual and a lab: "
                "section"
            )
    if not order.virtual:
        tracker_address.need_own(order.config)
    with ExitStack() as first:
        # Before anything of another daemon's could be touched.
        control = _control_socket(order)
        if control is not None:
            first.callback(control.close)
        return _run(order, control)


def _control_socket(order: Order) -> ControlSocket | None:
    """Held from here on; in virtual time only where people are to be served."""
    if order.virtual and not order.serve:
        return None
    settings = order.config.operation.socket
    path = order.socket or Path(settings.path)
    try:
        return ControlSocket(path if order.socket else runtime_dir() / path, settings)
    except ControlSocketError as error:
        raise ToolError(str(error)) from error


def _run(order: Order, control: ControlSocket | None) -> Result:
    if not order.virtual:
        demand(order.config.realtime)
        order = replace(order, config=bridged_where_alone(order.config))
    make_folder(order.out)
    if not rehearse(order.config, order.scenario):
        raise ToolError("the control cycle does not reach ACTIVE even with an obedient robot")
    folder = RunFolder(order.out, link=order.link)
    with ring_directory(order.say) as rings, folder.occupied(), ExitStack() as cleanup:
        stage = _Stage(order, rings, folder, cleanup, control)
        return stage.virtual() if order.virtual else stage.real()


class _Stage:
    """The parts of one run, and the order in which they come and go."""

    def __init__(
        self,
        order: Order,
        rings: Path,
        folder: RunFolder,
        cleanup: ExitStack,
        control: ControlSocket | None,
    ) -> None:
        config = order.config
        self._control, self._notifier = control, Notifier({} if order.virtual else os.environ)
        rates = order.config.control.rates
        step_ns = rates.status_divisor * rates.period_ns
        shown = order.live and not order.serve
        self._shown = (order.scenario.duration, step_ns) if shown else None
        self._order, self._ring_folder, self._cleanup = order, rings, cleanup
        self._folder, self._log = folder, folder.path / LOG
        self._realtime = settled(config.realtime)
        patience = config.operation.self_test.patience_s
        script = None
        if not order.serve:
            played, period = order.scenario, config.control.rates.period
            script = Script(played.duration, patience, played.operator, period)
        self._console = Console(script)
        self._image = ProcessImage(config.robot.cables)
        self._rings = Rings(rings, config, touched=not order.virtual)
        self._describe()
        self._firewall = Firewall(config.operation.firewall.failures)
        frames = self._rings.frames
        self._tap: FrameTap | None = None
        if frames is not None:
            self._tap = GuardedTap(frames, self._firewall.part("frame tap"))
        self._began = 0.0
        self._too_large = self._hung_up = False
        self._hygiene: Hygiene | None = None
        self._latencies: Latencies | None = None
        self._daemon_made: Daemon | None = None

    def virtual(self) -> Result:
        order = self._order
        live = Live(*self._shown) if self._shown else None
        lines = (
            EventLines(self._ring_folder, journal=for_journal(os.environ)) if order.serve else None
        )
        recorder = Recorder(
            self._ring_folder,
            self._log,
            order.config.recording,
            self._metadata(),
            self._attachments(),
            0,
            live.update if live else None,
            Scene.of(order.config),
        )

        async def main() -> Outcome:
            def drain() -> None:
                recorder.drain()
                if lines is not None:
                    lines.tell()

            cycles = self._rings.cycles
            with self._lab() as lab, supervised(order.config, cycles) as ring:
                fieldbus = fieldbuses.build(order.config, self._image, lab, self._tap)
                daemon = self._daemon(fieldbus, lab, clock.Stopwatch(running=False), ring)
                if order.serve:
                    self._serve_lab(lab, daemon)
                self._release_load(daemon, lab.release_load)
                pacing = fieldbuses.steering(order.config, fieldbus, order.pacing or self._pacing)
                # In this loop in virtual time only: a process of its own otherwise.
                part = self._firewall.part("recorder")
                draining = every(DRAIN_S, lambda: part.call(drain))
                try:
                    return await daemon.run(pacing, order.say, self._begin, start_ns=order.start_ns)
                finally:
                    draining()
                    drain()

        try:
            with self._signals():
                outcome = clock.run(main(), virtual=True)
                seconds = self._seconds()
        finally:
            recorder.finish()
            if live:
                live.close()
        return Result(outcome, self._log, seconds, unrecorded=recorder.stopped)

    def real(self) -> Result:
        order = self._order
        comparison = compared(self._realtime)
        if comparison is not None:
            order.say(str(comparison))
            self._realtime = self._realtime.model_copy(update={"awake": comparison.better})
        realtime = self._realtime
        lab = self._lab_process()
        recorder = self._recorder_process()
        config = order.config.model_copy(update={"realtime": self._realtime})
        supervisor = supervisor_of(config, self._ring_folder, order.say)
        if supervisor is not None:
            self._cleanup.callback(supervisor.stop)
        watched = stall_watch(realtime, order.say)
        if watched is not None:
            self._cleanup.callback(watched.process.stop)
        early, spin = realtime.early_wake_us * 1000, realtime.spin_us * 1000

        async def main() -> Outcome:
            fieldbus = fieldbuses.build(order.config, self._image, tap=self._tap)
            stalled_ns = clock.no_stalls if watched is None else watched.stalls.until
            stopwatch = clock.Stopwatch(running=True, stalled_ns=stalled_ns)
            daemon = self._daemon(fieldbus, None, stopwatch, self._rings.cycles)
            self._latencies = daemon.latencies
            if lab is not None:
                self._release_load(daemon, partial(lab.ask, RELEASE))
            # Before the bring-up, since it takes longer than the drives wait for a heartbeat.
            self._hygiene = hygiene = Hygiene(realtime)
            self._cleanup.callback(hygiene.release)
            for grant in hygiene.grants:
                order.say(str(grant))
            usual = order.pacing or partial(TimerPacing, early, spin)
            pacing = fieldbuses.steering(order.config, fieldbus, usual)
            return await daemon.run(pacing, order.say, self._begin)

        before = stolen_jiffies()
        try:
            with self._signals(), output.hurried():
                outcome = clock.run(main(), virtual=False)
            seconds = self._seconds()
        finally:
            self._notifier.stopping()
            if self._hygiene is not None:
                self._hygiene.release()
            if supervisor is not None:
                supervisor.stop()
            if watched is not None and not watched.at_work:
                order.say("the watch for stalls of the host had ended: they count as own misses")
            left = recorder.stop()
            if left is not None:
                order.say(f"the recorder was killed; what it left is in {left}")
            if lab is not None:
                lab.stop()
        stolen, total = (now - then for now, then in zip(stolen_jiffies(), before, strict=True))
        steal = 100.0 * stolen / total if total else 0.0
        grants = self._hygiene.grants if self._hygiene is not None else []
        unrecorded = recorder.stopped
        return Result(outcome, self._log, seconds, steal, grants, unrecorded, self._latencies)

    def _describe(self) -> None:
        """For viewers, which find the rings by it."""
        order, files = self._order, self._attachments()
        describe_run(
            self._ring_folder,
            Description(
                files["config.yaml"].decode(),
                files["scenario.yaml"].decode(),
                files.get("catalogue.yaml", b"").decode(),
                order.config.name,
                order.virtual,
                order.serve,
                None if self._control is None else str(self._control.path),
                str(self._log.absolute()),
            ),
        )

    def _begin(self) -> None:
        self._folder.started()
        self._notifier.ready()
        self._began = clock.wall_seconds()

    def _seconds(self) -> float:
        """s of wall time since the first tick; 0: there was none."""
        return clock.wall_seconds() - self._began if self._began else 0.0

    @contextmanager
    def _lab(self) -> Iterator[Lab]:
        """A lab in this process, gone again whatever happens."""
        order = self._order
        if order.config.lab is None:
            raise ToolError("virtual time needs a lab: section in the configuration")
        lab = Lab(
            order.config,
            order.scenario.lab,
            seed=order.seed,
            clock=clock.loop_clock(),
            truth=self._rings.truth().publish,
        )
        try:
            lab.open()
            yield lab
        finally:
            lab.close()

    def _serve_lab(self, lab: Lab, daemon: Daemon) -> None:
        """Its control socket, after each tick: in real time the lab's own process has it."""
        path = runtime_dir() / LAB_DOOR
        remove_stale(path, socket.SOCK_DGRAM)
        door = DoorSocket(Door(lab), path, lambda: lab.advance(clock.now_ns()), lambda: None)
        self._cleanup.callback(door.close)
        daemon.serve("control socket of the lab", door.poll)

    def _release_load(self, daemon: Daemon, release: Callable[[], None]) -> None:
        """Have the scenario's load end with the run: whoever pulls at a robot stops pulling when
        it is stopped. A stop for a fault is left to cope with it."""
        script, sequence = self._order.scenario.lab, daemon.cycle.sequence
        if script.load is None and script.displacement is None:
            return
        daemon.serve("load of the lab", releasing(lambda: script, sequence, release))

    def _lab_process(self) -> ChildProcess | None:
        order = self._order
        if order.config.lab is None:
            return None
        config = order.config.model_copy(update={"realtime": self._realtime})
        lab = start_lab(config, order.scenario, order.seed, self._ring_folder, self._rings.ticks)
        self._cleanup.callback(lab.stop)
        return lab

    def _metadata(self) -> dict[str, str]:
        order = self._order
        return provenance.metadata(
            order.config, order.scenario, seed=order.seed, virtual=order.virtual
        )

    def _attachments(self) -> dict[str, bytes]:
        order = self._order
        return provenance.attachments(order.config, order.scenario, order.others)

    def _recorder_process(self) -> RecorderProcess:
        order = self._order
        realtime, health = self._realtime, doctor.latest(order.config, order.out)
        attachments = {"doctor.json": json.dumps(health, indent=2, sort_keys=True).encode()}
        recorder = start(
            self._ring_folder,
            self._log,
            order.config.recording,
            self._metadata() | provenance.host() | doctor.metadata(health),
            self._attachments() | attachments,
            clock.utc_offset_ns(),
            priority=realtime.of(realtime.recorder_priority),
            processors=realtime.on(realtime.recorder_cpu),
            live=self._shown,
            tell_events=order.serve,
            scene=Scene.of(order.config),
        )
        self._cleanup.callback(recorder.stop)
        return recorder

    def _daemon(
        self, fieldbus: Fieldbus, lab: Lab | None, stopwatch: clock.Stopwatch, ring: Ring
    ) -> Daemon:
        config, image = self._order.config, self._image
        source: TrackerSource
        heard, tracker = EventLog(), config.tracker
        if lab is not None:
            source = lab.tracker
        else:
            silence_ms = tracker.maximum_age_ms
            source = UdpTracker(tracker.address, tracker.port, silence_ms, heard)
            self._cleanup.callback(source.close)
        order = self._order
        daemon = self._daemon_made = Daemon(
            config,
            order.scenario,
            fieldbus,
            TrackerInput(image, source, heard),
            self._console,
            ring=ring,
            events=self._rings.events.write,
            stopwatch=stopwatch,
            keyframes=self._keep_state,
            others=order.others,
            firewall=self._firewall,
        )
        control, beat, sequence = self._control, self._notifier.beat, daemon.cycle.sequence
        if control is not None:
            catalogue = (order.scenario, *order.others)
            control.open_to(ControlDoor(config, daemon, self._console, catalogue, str(self._log)))
            daemon.serve("emergency stop", control.listen, lasting=True)
            daemon.serve("control socket", control.poll)
            daemon.serve("signal", self._tell_hang_up)
            # Lasting: without it the service manager would kill the daemon, the robot at height.
            daemon.serve(
                "service notification", lambda due_ns: beat(due_ns, sequence.state), lasting=True
            )
        return daemon

    def _keep_state(self, stamp_ns: int, tick: int, state: bytes) -> None:
        """A keyframe; the first one that no ring has room for is told, and no other."""
        if not self._rings.keyframes.write(stamp_ns, tick, state) and not self._too_large:
            self._too_large = True
            text = (
                f"the controller's state has {len(state)} bytes, and {KEYFRAME_BYTES} is the "
                "limit; a replay has to begin at an earlier keyframe or at the first tick"
            )
            self._rings.events.write(stamp_ns, tick, Level.WARNING, "keyframe_left_out", "", text)

    def _pacing(self) -> Pacing:
        """Of virtual time."""
        order, daemon = self._order, self._daemon_made
        if not order.serve or daemon is None:
            return VirtualPacing()
        sequence = daemon.cycle.sequence
        return IdlePacing(
            lambda: sequence.state in _DISARMED, order.config.operation.virtual_idle_speed
        )

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """The first SIGINT or SIGTERM asks for a controlled stop, the second disables at once.
        SIGHUP, a terminal that is gone, is a stop too, except of a daemon that serves."""
        ends = [signal.SIGINT, signal.SIGTERM]
        kept = {signal.SIGHUP: signal.signal(signal.SIGHUP, lambda *_: self._hang_up())}
        for number in ends:
            kept[number] = signal.signal(number, lambda which, _: self._end(which))
        try:
            yield
        finally:
            for number, handler in kept.items():
                signal.signal(number, handler)

    def _end(self, number: int) -> None:
        self._console.stop(f"signal {signal.Signals(number).name}")

    def _hang_up(self) -> None:
        if not self._order.serve:
            self._end(signal.SIGHUP)
        else:
            # Told after a tick: an event may be on its way into its ring just now.
            self._hung_up = True

    def _tell_hang_up(self, due_ns: int) -> None:
        del due_ns
        if self._hung_up and self._daemon_made is not None:
            self._hung_up = False
            text = "SIGHUP: nothing to do; the configuration is read at the start only"
            self._daemon_made.note(Level.INFO, "signal", text)
