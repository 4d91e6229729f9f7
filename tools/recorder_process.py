"""The recorder as a process of its own, for runs in real time; `tools.recorder_keeper` starts it,
and again when it dies.

    python -m tools.recorder_process RING_DIR OUT JOB

JOB is a JSON file that `start` writes. The daemon holds the other end of this process's standard
input: the byte "q" asks for the end of the recording, and a closed pipe without it means that the
daemon is gone. Either way what is left in the rings is recorded and the file finished.
"""

from __future__ import annotations

import base64
import fcntl
import json
import select
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from config.schema.control import Recording
from runtime.realtime import prepare
from runtime.recorder import Recorder
from runtime.ring import RingReader
from runtime.taps import Level
from runtime.viewer import Scene
from tools.cli.live import Live
from tools.recorder_keeper import INCOMPLETE

_QUIT = b"q"
_DRAIN_PERIOD_S = 0.05
_REST = "rest"
"""an argument: record only if something was left"""
_STATUS = "recorder.status"
_LOCK = "recorder.lock"


@dataclass
class RecorderProcess:
    """A recorder at work, seen from the daemon."""

    process: subprocess.Popen[bytes]
    """its keeper"""
    ring_dir: Path
    command: list[str]
    """the recorder's own"""

    def stop(self, timeout_s: float = 30.0) -> None:
        """Ask for the end and wait for the finished file, which takes a recorder of its own where
        the keeper was killed."""
        pipe = self.process.stdin
        if pipe is not None and self.process.poll() is None:
            try:
                pipe.write(_QUIT)
                pipe.close()
            except BrokenPipeError:
                pass  # it ended by itself; its exit code tells how
        if self.process.wait(timeout_s) not in (0, INCOMPLETE):
            rest = [*self.command, _REST]
            subprocess.run(rest, input=_QUIT, check=False, timeout=timeout_s)

    @property
    def stopped(self) -> str:
        """Why nothing is being recorded, in words; empty while something is."""
        try:
            return (self.ring_dir / _STATUS).read_text(encoding="utf-8")
        except FileNotFoundError:
            return ""


def start(
    ring_dir: Path,
    out: Path,
    recording: Recording,
    metadata: dict[str, str],
    attachments: dict[str, bytes],
    utc_offset_ns: int,
    *,
    priority: int = 0,
    live_duration_s: float | None = None,
    scene: Scene | None = None,
) -> RecorderProcess:
    """Start a recorder for the rings in ``ring_dir``. With ``live_duration_s`` it also shows the
    live line on standard output."""
    job = {
        "recording": recording.model_dump(mode="json"),
        "metadata": metadata,
        "attachments": {
            name: base64.b64encode(data).decode() for name, data in attachments.items()
        },
        "utc_offset_ns": utc_offset_ns,
        "priority": priority,
        "live_duration_s": live_duration_s,
        "scene": None if scene is None else asdict(scene),
    }
    path = ring_dir / "recorder.json"
    path.write_text(json.dumps(job, sort_keys=True), encoding="utf-8")
    command = [sys.executable, "-m", "tools.recorder_process", str(ring_dir), str(out), str(path)]
    # A group of its own: Ctrl-C is for the daemon, which then decides when the recording ends.
    process = subprocess.Popen(
        [sys.executable, "-m", "tools.recorder_keeper", str(priority), str(ring_dir), *command],
        stdin=subprocess.PIPE,
        process_group=0,
    )
    return RecorderProcess(process, ring_dir, command)


def run(ring_dir: Path, out: Path, job: dict[str, Any]) -> bool:
    """Record until asked to stop or left alone. Gives whether all of it could be written."""
    prepare(priority=job["priority"], processor=None, lock_memory=False)
    duration, scene = job["live_duration_s"], job["scene"]
    live = Live(duration) if duration is not None else None
    recorder = Recorder(
        ring_dir,
        out,
        Recording.model_validate(job["recording"]),
        job["metadata"],
        {name: base64.b64decode(text) for name, text in job["attachments"].items()},
        job["utc_offset_ns"],
        live.update if live else None,
        Scene(**scene) if scene else None,
    )
    daemon, said = sys.stdin.fileno(), ""
    while not select.select([daemon], [], [], _DRAIN_PERIOD_S)[0]:
        recorder.drain()
        said = _tell(ring_dir, recorder.stopped, said)
    if sys.stdin.buffer.read(1) != _QUIT:
        recorder.drain()
        recorder.event(
            Level.FATAL, "daemon_lost", "daemon", "the daemon ended without a word; recorded so far"
        )
    recorder.finish()
    _tell(ring_dir, recorder.stopped, said)
    if live is not None:
        live.close()
    return not recorder.stopped


def _tell(ring_dir: Path, stopped: str, before: str) -> str:
    """Say, and note for whoever asks, when recording stops or goes on."""
    if stopped != before:
        (ring_dir / _STATUS).write_text(stopped, encoding="utf-8")
        text = f"stopped: {stopped}" if stopped else "goes on"
        sys.stderr.write(f"recording {text}\n")
    return stopped


def _is_done(ring_dir: Path) -> bool:
    """Everything published was recorded by an earlier recorder."""
    readers = [RingReader.open(path) for path in sorted(ring_dir.glob("*.ring"))]
    done = all(reader.cursor >= reader.published for reader in readers)
    started = any(reader.cursor for reader in readers)
    for reader in readers:
        reader.close()
    return done and started


def main() -> None:
    """The process that a keeper starts."""
    ring_dir, out, job = (Path(argument) for argument in sys.argv[1:4])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with (ring_dir / _LOCK).open("w") as lock:
        # One that lost its keeper may still be at work.
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _REST in sys.argv and _is_done(ring_dir):
            return
        if not run(ring_dir, out, json.loads(job.read_text(encoding="utf-8"))):
            sys.exit(INCOMPLETE)


if __name__ == "__main__":
    main()
