"""The watch for stalls of the host as a process of its own, for runs in real time.

    python -m tonus.tools.run.stall_watch_process FD PERIOD_NS PRIORITY PROCESSORS

FD is memory shared with the daemon, PROCESSORS a JSON list. It ends when its standard input
closes: with the daemon.
"""

from __future__ import annotations

import json
import mmap
import os
import select
import signal
import sys
from dataclasses import dataclass

from tonus.config.schema.realtime import RealTime
from tonus.drivers.fieldbus import Progress
from tonus.runtime.timing.realtime import freeze_collector, prepare
from tonus.runtime.timing.stalls import BYTES, Stalls, StallWatch
from tonus.tools.errors import ToolError
from tonus.tools.run.child_process import READY, ChildProcess, say, start_child

_COMMAND = (sys.executable, "-m", "tonus.tools.run.stall_watch_process")
_START_S = 30.0
_LOOK = 200
"""periods between two looks at standard input"""


@dataclass(frozen=True)
class Watched:
    """A watch at work, and what it has seen."""

    process: ChildProcess
    stalls: Stalls

    @property
    def at_work(self) -> bool:
        return self.process.process.poll() is None


def stall_watch(settings: RealTime, report: Progress) -> Watched | None:
    """Start one beside a daemon with a processor of its own, whose settings are `settled`. None
    where none is asked for or there is no other processor; what keeps it from starting is reported,
    since it only tells whose a missed tick is."""
    processors = sorted(os.sched_getaffinity(0) - {settings.daemon_cpu})
    alone = not processors or settings.daemon_cpu is None
    if settings.policy == "off" or settings.stall_watch_us is None or alone:
        return None
    memory = os.memfd_create("tonus-stalls", 0)
    try:
        os.ftruncate(memory, BYTES)
        shared = mmap.mmap(memory, BYTES)
        words = (memory, settings.stall_watch_us * 1000, settings.daemon_priority)
        command = [*_COMMAND, *map(str, words), json.dumps(processors)]
        remedy = "reduce the load on this host"
        child = start_child(command, "the stall watch", _START_S, remedy, (memory,))
    except (ToolError, OSError) as error:
        report(f"without a watch for stalls of the host: {error}")
        return None
    finally:
        os.close(memory)
    return Watched(child, Stalls(shared))


def main() -> None:
    """The process that `stall_watch` starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory, period_ns, priority = map(int, sys.argv[1:4])
    prepare(priority=priority, processors=tuple(json.loads(sys.argv[4])), lock_memory=True)
    watch = StallWatch(mmap.mmap(memory, BYTES), period_ns)
    freeze_collector()
    say(READY)
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        for _ in range(_LOOK):
            watch.wait()


if __name__ == "__main__":
    main()
