"""The lab as a process of its own, for runs in real time.

    python -m tonus.tools.run.lab_process JOB

JOB is a JSON file that `start_lab` writes. The process says "ready" on standard output when its
sockets are open, and ends when its standard input closes: with the daemon that started it.
`RELEASE` on standard input ends the scenario's load.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from tonus.config.places import runtime_dir
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.timing import clock
from tonus.runtime.timing.realtime import freeze_collector, prepare
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab, TruthSink
from tonus.sim.lab.server import serve
from tonus.tools import output
from tonus.tools.run.child_process import READY, ChildProcess, say, start_child
from tonus.tools.run.truth import TruthRing

RELEASE = b"r"
_COMMAND = (sys.executable, "-m", "tonus.tools.run.lab_process")


def start_lab(
    config: Config, scenario: Scenario, seed: int, rings: Path, truth_capacity: int
) -> ChildProcess:
    """Start a lab on the configuration's buses and wait until it answers.

    Raises `ToolError` with the lab's own words when it cannot start, or when it does not answer
    within `lab.start_timeout_s`; then it has been killed.
    """
    assert config.lab is not None
    job = {
        "config": config.model_dump(mode="json"),
        "scenario": scenario.model_dump(mode="json"),
        "seed": seed,
        "truth": str(rings / "truth.ring"),
        "truth_capacity": truth_capacity,
    }
    path = rings / "lab.json"
    path.write_text(json.dumps(job), encoding="utf-8")
    remedy = "reduce the load on this host, or set lab.start_timeout_s higher"
    return start_child([*_COMMAND, str(path)], "the lab", config.lab.start_timeout_s, remedy)


async def work(
    config: Config,
    scenario: Scenario,
    seed: int,
    truth: TruthSink | None,
    ready: Callable[[Lab], None],
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
        ready(lab)

    await serve(lab, config, runtime_dir(), answer, clock.utc_offset_ns)


async def _until_left_alone(job: dict[str, Any]) -> None:
    """Serve until standard input closes."""
    config = Config.model_validate(job["config"])
    scenario = Scenario.model_validate(job["scenario"])
    truth = TruthRing(Path(job["truth"]), job["truth_capacity"], config.robot.cables, touched=True)
    loop, standard_input = asyncio.get_running_loop(), sys.stdin.fileno()

    def ready(lab: Lab) -> None:
        loop.add_reader(standard_input, asked, lab)
        say(READY)

    def asked(lab: Lab) -> None:
        if os.read(standard_input, len(RELEASE)) != RELEASE:
            working.cancel()
        else:
            lab.advance(lab.clock())
            lab.release_load()

    working = loop.create_task(work(config, scenario, job["seed"], truth.publish, ready))
    with suppress(asyncio.CancelledError):
        await working


def main() -> None:
    """The process that `start_lab` starts."""
    output.install()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    try:
        clock.run(_until_left_alone(job), virtual=False)
    except (LabError, OSError) as error:
        say(str(error).encode())
        sys.exit(2)


if __name__ == "__main__":
    main()
