"""The lab as a process of its own, for runs in real time.

    python -m tools.lab_process JOB

JOB is a JSON file that `start_lab` writes. The process says "ready" on standard output when its
sockets are open, and ends when its standard input closes: with the daemon that started it.
"""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from config.places import runtime_dir
from config.schema.root import Config
from config.schema.scenario import Scenario
from runtime import clock
from runtime.realtime import freeze_collector, prepare
from sim.errors import LabError
from sim.lab import Lab, TruthSink
from sim.server import serve
from tools.errors import ToolError
from tools.truth import TruthRing

_READY = b"ready\n"


@dataclass
class LabProcess:
    """A lab at work, seen from the daemon."""

    process: subprocess.Popen[bytes]

    def stop(self, timeout_s: float = 10.0) -> None:
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.wait(timeout_s)


def start_lab(
    config: Config, scenario: Scenario, seed: int, rings: Path, truth_capacity: int
) -> LabProcess:
    """Start a lab on the configuration's buses and wait until it answers.

    Raises `ToolError` with the lab's own words when it cannot start.
    """
    job = {
        "config": config.model_dump(mode="json"),
        "scenario": scenario.model_dump(mode="json"),
        "seed": seed,
        "truth": str(rings / "truth.ring"),
        "truth_capacity": truth_capacity,
    }
    path = rings / "lab.json"
    path.write_text(json.dumps(job), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "tools.lab_process", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,
    )
    assert process.stdout is not None
    answer = process.stdout.readline()
    if answer != _READY:
        process.wait()
        words = answer.decode(errors="replace").strip() or "it ended without a word"
        raise ToolError(f"the lab did not start: {words}")
    return LabProcess(process)


async def work(
    config: Config,
    scenario: Scenario,
    seed: int,
    truth: TruthSink | None,
    ready: Callable[[], None],
    nodes: frozenset[tuple[str, int]] | None = None,
) -> None:
    """A lab on the configuration's buses, in real time, until cancelled; ``nodes`` as in `Lab`.

    Raises `LabError`.
    """
    realtime = config.realtime
    priority = realtime.of(realtime.lab_priority)
    prepare(priority=priority, processors=realtime.on(realtime.lab_cpu), lock_memory=False)
    now = clock.loop_clock()
    lab = Lab(config, scenario.lab, seed=seed, clock=now, truth=truth, start_ns=now(), nodes=nodes)

    def answer() -> None:
        freeze_collector()
        ready()

    await serve(lab, config, runtime_dir(), answer, clock.utc_offset_ns)


async def _until_left_alone(job: dict[str, Any]) -> None:
    """Serve until standard input closes."""
    config = Config.model_validate(job["config"])
    scenario = Scenario.model_validate(job["scenario"])
    truth = TruthRing(Path(job["truth"]), job["truth_capacity"])
    working = asyncio.get_running_loop().create_task(
        work(config, scenario, job["seed"], truth.publish, lambda: _say(_READY))
    )
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), working.cancel)
    with suppress(asyncio.CancelledError):
        await working


def _say(text: bytes) -> None:
    sys.stdout.buffer.write(text)
    sys.stdout.buffer.flush()


def main() -> None:
    """The process that `start_lab` starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    try:
        clock.run(_until_left_alone(job), virtual=False)
    except (LabError, OSError) as error:
        _say(f"{error}\n".encode())
        sys.exit(2)


if __name__ == "__main__":
    main()
