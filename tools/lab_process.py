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
from dataclasses import dataclass
from pathlib import Path

from config.places import runtime_dir
from config.schema.root import Config
from config.schema.scenario import Scenario
from runtime import clock
from runtime.realtime import freeze_collector, prepare
from sim.lab import Lab
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


async def work(lab: Lab, config: Config, ready: bytes | None) -> None:
    """Serve until standard input closes."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    if ready is not None:
        loop.add_reader(sys.stdin.fileno(), ended.set)

    def answer() -> None:
        freeze_collector()
        if ready is not None:
            sys.stdout.buffer.write(ready)
            sys.stdout.buffer.flush()

    serving = loop.create_task(serve(lab, config, runtime_dir(), answer))
    ending = loop.create_task(ended.wait())
    await asyncio.wait({serving, ending}, return_when=asyncio.FIRST_COMPLETED)
    for task in (serving, ending):
        task.cancel()
    for result in await asyncio.gather(serving, ending, return_exceptions=True):
        if isinstance(result, Exception):
            raise result


def main() -> None:
    """The process that `start_lab` starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    config = Config.model_validate(job["config"])
    scenario = Scenario.model_validate(job["scenario"])
    realtime = config.realtime
    prepare(priority=realtime.lab_priority, processor=realtime.lab_cpu, lock_memory=False)

    async def run() -> None:
        truth = TruthRing(Path(job["truth"]), job["truth_capacity"])
        lab = Lab(
            config,
            scenario.lab,
            seed=job["seed"],
            clock=clock.now_ns,
            truth=truth.publish,
            start_ns=clock.now_ns(),
        )
        await work(lab, config, _READY)

    clock.run(run(), virtual=False)


if __name__ == "__main__":
    main()
