"""The supervisor as a process of its own, for runs in real time.

    python -m tonus.tools.run.supervisor_process JOB

JOB is a JSON file that `start_supervisor` writes. The process says "ready" on standard output when
it listens, and ends, and its heartbeat with it, when its standard input closes: with the daemon.
What ends it later it says on standard error, which is the daemon's.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import can

from tonus.config.schema.root import Config
from tonus.drivers.fieldbus import Progress
from tonus.runtime.errors import DaemonError
from tonus.runtime.recording.ring import RingReader
from tonus.runtime.supervisor.record import of_ring
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.timing import clock
from tonus.runtime.timing.realtime import freeze_collector, prepare
from tonus.runtime.timing.scheduler import TimerPacing
from tonus.tools import output
from tonus.tools.errors import ToolError
from tonus.tools.run.child_process import READY, ChildProcess, say, start_child
from tonus.tools.run.supervision import open_bus, require_reach, wanted, without_relay

_COMMAND = (sys.executable, "-m", "tonus.tools.run.supervisor_process")
_START_S = 60.0
_REASONS = (DaemonError, ToolError, can.CanError, OSError)
"""for which it ends with a line instead of a traceback"""


def start_supervisor(config: Config, rings: Path) -> ChildProcess:
    """Start one for the ring of cycles in ``rings`` and wait until it listens. Raises `ToolError`
    with its own words when it cannot."""
    job = {"config": config.model_dump(mode="json"), "ring": str(rings / "cycle.ring")}
    path = rings / "supervisor.json"
    path.write_text(json.dumps(job), encoding="utf-8")
    remedy = "reduce the load on this host"
    return start_child([*_COMMAND, str(path)], "the supervisor", _START_S, remedy)


def bridged_where_alone(config: Config) -> Config:
    """For a run in real time: without the relay where it has no supervisor for want of processors,
    since no drive could be enabled."""
    return config if config.relay is None or _enough(config) else without_relay(config)


def _enough(config: Config) -> bool:
    """Processors, for a supervisor beside a lab that may do without."""
    settings = config.supervisor
    if settings is None or config.lab is None or settings.policy != "use":
        return True
    return len(os.sched_getaffinity(0)) >= settings.processors


def supervisor_of(config: Config, rings: Path, report: Progress) -> ChildProcess | None:
    """The supervisor of a run in real time; None where none is asked for, or where the run may do
    without it and it does not start. Raises `ToolError` where it may not."""
    settings = config.supervisor
    if settings is None or settings.policy == "off":
        return None
    require_reach(config)
    if not _enough(config):
        there = len(os.sched_getaffinity(0))
        report(
            f"without a supervisor: beside a lab it needs {settings.processors} processors, this "
            f"host has {there}"
        )
        return None
    if not wanted(config):
        report("without a supervisor: no drive is on CAN and there is no sto_relay")
        return None
    try:
        return start_supervisor(config, rings)
    except ToolError as error:
        if settings.policy == "require" or config.relay is not None:
            raise
        report(f"without a supervisor (supervisor.policy is use): {error}")
        return None


async def _until_left_alone(job: dict[str, Any]) -> str:
    """Judge until standard input closes. Returns what has ended it before, in words; "" for
    nothing."""
    config = Config.model_validate(job["config"])
    ring = RingReader.look(Path(job["ring"]))
    records = of_ring(ring, config.robot.cables)
    supervisor = Supervisor(config, records, open_bus, clock.now_ns)
    settings, realtime = supervisor.settings, config.realtime
    prepare(
        priority=realtime.of(settings.priority),
        processors=realtime.on(settings.cpu),
        lock_memory=realtime.policy != "off" and realtime.lock_memory,
    )
    over = False

    def end() -> None:
        nonlocal over
        over = True

    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), end)
    period_ns = settings.period_ms * 1_000_000
    pacing = TimerPacing()
    freeze_collector()
    say(READY)
    due_ns = clock.now_ns()
    try:
        while not over:
            due_ns = max(due_ns + period_ns, clock.now_ns())
            await pacing.until(due_ns)
            supervisor.step(clock.now_ns())
    except _REASONS as error:
        return f"the supervisor has ended: {error}"
    finally:
        pacing.close()
        supervisor.close()
    return ""


def main() -> None:
    """The process that `start_supervisor` starts. Whoever started it reads standard output until
    it is ready, and not later."""
    output.install()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    try:
        ended = clock.run(_until_left_alone(job), virtual=False)
    except _REASONS as error:
        say(str(error).encode())
        sys.exit(2)
    if ended:
        sys.exit(ended)


if __name__ == "__main__":
    main()
