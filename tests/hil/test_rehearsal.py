"""After the rehearsal nothing is left to compile: what a first call costs, a tick cannot pay."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PLAY = """
import sys
from types import SimpleNamespace
from numba.core.dispatcher import Dispatcher
from tonus.runtime.operation.rehearsal import rehearse
from tonus.runtime.signals import CycleRecord
from tonus.runtime.states import State
from tonus.runtime.timing.latencies import Latencies, Marks
from tests.loop import QUICK, ClosedLoop, configured


def compiled():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("tonus.runtime."):
            for each in vars(module).values():
                if isinstance(each, Dispatcher):
                    found[f"{each.__module__}.{each.__name__}"] = len(each.signatures)
    return found


config, scenario = configured("contact", {**QUICK, "control.controller": sys.argv[1]})
assert rehearse(config, scenario)
before = compiled()
assert sum(before.values()) > 20
loop = ClosedLoop(config, scenario.model_copy(update={"duration": 5.0}))
assert loop.complete().state[-1] == State.STANDBY
lame = ClosedLoop(config, scenario)
lame.until(State.ACTIVE)
lame.silent_axes.add(3)
assert lame.complete().state[-1] == State.FAULT
record, marks = CycleRecord(config.robot.cables), Marks(0, 0, 0, 0)
late = SimpleNamespace(own=0, host=0, page_faults=0, switches=0)
scheduler = SimpleNamespace(misses=late, disturbances=late, wakeup_ns=0, period_ns=1_000_000)
Latencies().write(record, scheduler, marks, 0, (0, 0, 0), measured=True)
after = compiled()
print({name: count for name, count in after.items() if count != before.get(name, 0)})
"""


ALSO = pytest.mark.long


@pytest.mark.parametrize(
    "controller",
    [
        "bio_observer",
        pytest.param("pid_length", marks=ALSO),
        pytest.param("bio", marks=ALSO),
        pytest.param("force", marks=ALSO),
    ],
)
def test_a_run_compiles_nothing_that_its_rehearsal_has_not(controller: str) -> None:
    root = Path(__file__).parents[2]
    order = [sys.executable, "-c", PLAY, controller]
    done = subprocess.run(order, cwd=root, capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.strip() == "{}"
