"""Keeps a recorder alive: starts it, and again when it dies; what it had not written by then still
stands in the rings. A process of its own, since starting one from the daemon would cost it a tick.

The first one takes its priority when it has loaded its code: nothing is recorded yet, and a
real-time process that leaves others nothing of a second makes the kernel hold all of them back.

    python -m tonus.tools.run.recorder_keeper PRIORITY RING_DIR COMMAND...
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tonus.runtime.recording.ring import RingReader
from tonus.tools import output

INCOMPLETE = 3
"""exit code of a recorder that ended while the disk had no room"""
_ATTEMPTS = 5
"""deaths in a row, with nothing recorded in between, before a recorder is given up"""


def keep(ring_dir: Path, command: list[str], priority: int) -> int:
    """Run a recorder to its end, which its standard input decides. Gives its exit code."""
    code, failures, recorded = 0, 0, -1
    while failures < _ATTEMPTS:
        code = subprocess.run(command, check=False).returncode
        if code in (0, INCOMPLETE):
            return code
        sys.stderr.write(f"the recorder ended with {code} and is started again\n")
        if priority:
            _hasten(priority)
        before, recorded = recorded, _recorded(ring_dir)
        failures = 1 if recorded > before else failures + 1
    sys.stderr.write(f"the recorder ended {_ATTEMPTS} times and is given up\n")
    return code


def _hasten(priority: int) -> None:
    """A recorder that starts slowly on a busy host loses what the rings cannot hold, so one that
    is started again has its priority from its first instruction on. A refusal is the recorder's to
    report."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        sys.stderr.write(f"recorder without SCHED_FIFO: {error.strerror}\n")


def _recorded(ring_dir: Path) -> int:
    """Records that some recorder has stored."""
    count = 0
    for path in sorted(ring_dir.glob("*.ring")):
        reader = RingReader.open(path)
        count += reader.cursor
        reader.close()
    return count


if __name__ == "__main__":
    output.install()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(keep(Path(sys.argv[2]), sys.argv[3:], int(sys.argv[1])))
