"""The recorder as a process of its own, for runs in real time; `tonus.tools.run.recorder_keeper`
starts it, and again when it dies.

    python -m tonus.tools.run.recorder_process RING_DIR OUT JOB

JOB is a JSON file that `start` writes. The daemon holds the other end of this process's standard
input: the byte "q" asks for the end of the recording, and a closed pipe without it means that the
daemon is gone. Either way what is left in the rings is recorded and the file finished.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tonus.config.schema.control import Recording
from tonus.config.schema.realtime import Processors
from tonus.runtime.recording.recorder import Recorder, Watch
from tonus.runtime.recording.ring import RingReader
from tonus.runtime.recording.taps import Level
from tonus.runtime.recording.viewer import Scene
from tonus.runtime.timing.realtime import prepare
from tonus.tools import output
from tonus.tools.cli.live import Live
from tonus.tools.errors import ToolError
from tonus.tools.event_lines import EventLines, for_journal
from tonus.tools.run.recorder_keeper import INCOMPLETE

JOB = "recorder.json"
"""what a recorder is to do, beside its rings"""
_QUIT = b"q"
_DRAIN_PERIOD_S = 0.05
_STATUS = "recorder.status"
_LOCK = "recorder.lock"


@dataclass
class RecorderProcess:
    """A recorder at work, seen from the daemon."""

    process: subprocess.Popen[bytes]
    """its keeper"""
    ring_dir: Path

    def stop(self, timeout_s: float = 30.0) -> Path | None:
        """Ask for the end and wait for the finished file. Gives the file that took what a recorder
        without its keeper left, None almost always."""
        pipe = self.process.stdin
        if pipe is not None and not pipe.closed:
            try:
                # Also where the keeper has been killed: a recorder without it still listens.
                pipe.write(_QUIT)
                pipe.close()
            except BrokenPipeError:
                pass  # both have ended by themselves; the exit code tells how
        if self.process.wait(timeout_s) in (0, INCOMPLETE):
            return None
        return salvage(self.ring_dir, wait=True)

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
    processors: Processors | None = None,
    live: tuple[float, int] | None = None,
    scene: Scene | None = None,
    tell_events: bool = False,
) -> RecorderProcess:
    """Start a recorder for the rings in ``ring_dir``. With ``live``, what `Live` is made with, it
    also shows the live line on standard output, with ``tell_events`` a line for each event."""
    job = {
        "recording": recording.model_dump(mode="json"),
        "metadata": metadata,
        "attachments": {
            name: base64.b64encode(data).decode() for name, data in attachments.items()
        },
        "utc_offset_ns": utc_offset_ns,
        "priority": priority,
        "processors": processors,
        "live": live,
        "scene": None if scene is None else asdict(scene),
        "tell_events": tell_events,
        "out": str(out),
    }
    path = ring_dir / JOB
    path.write_text(json.dumps(job, sort_keys=True), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "tonus.tools.run.recorder_process",
        str(ring_dir),
        str(out),
        str(path),
    ]
    # A group of its own: Ctrl-C is for the daemon, which then decides when the recording ends.
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "tonus.tools.run.recorder_keeper",
            str(priority),
            str(ring_dir),
            *command,
        ],
        stdin=subprocess.PIPE,
        process_group=0,
    )
    return RecorderProcess(process, ring_dir)


def run(ring_dir: Path, out: Path, job: dict[str, Any]) -> bool:
    """Record until asked to stop or left alone. Gives whether all of it could be written."""
    prepare(priority=job["priority"], processors=job["processors"], lock_memory=False)
    live = Live(*job["live"]) if job["live"] is not None else None
    recorder = _recorder(ring_dir, out, job, live.update if live else None)
    lines = EventLines(ring_dir, journal=for_journal(os.environ)) if job["tell_events"] else None
    daemon, said = sys.stdin.fileno(), ""
    while not select.select([daemon], [], [], _DRAIN_PERIOD_S)[0]:
        recorder.drain()
        said = _tell(ring_dir, recorder.stopped, said)
        if lines is not None:
            lines.tell()
    if sys.stdin.buffer.read(1) != _QUIT:
        recorder.drain()
        recorder.event(
            Level.FATAL, "daemon_lost", "daemon", "the daemon ended without a word; recorded so far"
        )
    if lines is not None:
        lines.tell()
    recorder.finish()
    _tell(ring_dir, recorder.stopped, said)
    if live is not None:
        live.close()
    return not recorder.stopped


def salvage(ring_dir: Path, *, wait: bool = False) -> Path | None:
    """Record what a recorder that was killed left in its rings; gives the file, or None where
    nothing is left. While that recorder is still at work: ``wait`` for its end, or raise
    `ToolError`."""
    job_file = ring_dir / JOB
    if not job_file.exists():
        return None
    with _hold(ring_dir, wait=wait) as held:
        if not held:
            raise ToolError(f"{ring_dir}: its recorder is still at work; wait a moment")
        if not any(_unread(path) for path in ring_dir.glob("*.ring")):
            return None
        job = json.loads(job_file.read_text(encoding="utf-8"))
        recorder = _recorder(ring_dir, Path(job["out"]), job)
        text = "the recorder ended without a word; this is what it left in the rings"
        recorder.event(Level.ERROR, "recorder_lost", "recorder", text)
        recorder.finish()
    return recorder.path


def _unread(path: Path) -> bool:
    reader = RingReader.open(path)
    try:
        return reader.cursor < reader.published
    finally:
        reader.close()


@contextmanager
def _hold(ring_dir: Path, *, wait: bool) -> Iterator[bool]:
    """Whether these rings are ours alone; the lock goes with the process, however it ends."""
    with (ring_dir / _LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        yield True


def _recorder(
    ring_dir: Path, out: Path, job: dict[str, Any], watch: Watch | None = None
) -> Recorder:
    return Recorder(
        ring_dir,
        out,
        Recording.model_validate(job["recording"]),
        job["metadata"],
        {name: base64.b64decode(text) for name, text in job["attachments"].items()},
        job["utc_offset_ns"],
        watch,
        Scene.read(scene) if (scene := job["scene"]) else None,
    )


def _tell(ring_dir: Path, stopped: str, before: str) -> str:
    """Say, and note for whoever asks, when recording stops or goes on."""
    if stopped != before:
        (ring_dir / _STATUS).write_text(stopped, encoding="utf-8")
        text = f"stopped: {stopped}" if stopped else "goes on"
        sys.stderr.write(f"recording {text}\n")
    return stopped


def main() -> None:
    """The process that a keeper starts."""
    ring_dir, out, job = (Path(argument) for argument in sys.argv[1:4])
    output.install()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # One that lost its keeper may still be at work.
    with _hold(ring_dir, wait=True), output.hurried():
        if not run(ring_dir, out, json.loads(job.read_text(encoding="utf-8"))):
            sys.exit(INCOMPLETE)


if __name__ == "__main__":
    main()
