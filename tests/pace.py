"""How evenly the host's processors compute, measured when a test in real time has failed.

A host that other guests share takes up to twice as long for the same computation, and ticks come
late one by one, without a stall that a watcher would see. The computation is the standard
library's, above the priorities of the daemon and its helpers: nothing of Tonus changes what is
measured.
"""

from __future__ import annotations

import ast
import copy
import inspect
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence

_TIMES = 80
"""computations of some milliseconds on each processor: short of the second after which the kernel
lets other processes run"""
_SHARE = 0.9
_least: list[int] = []
"""ns of the quickest computation so far"""


def unevenness(processors: Iterable[int] | None = None) -> float:
    """How many times as long as the quickest computation so far the present ones take, nine of ten
    of them at most; of several processors at once the slowest counts. 1.0 where the host refuses
    SCHED_FIFO, without which other work would count."""
    used = sorted(os.sched_getaffinity(0)) if processors is None else processors
    command = [sys.executable, "-S", __file__]
    running = [
        subprocess.Popen([*command, str(each)], stdout=subprocess.PIPE, text=True) for each in used
    ]
    return compared([json.loads(process.communicate()[0]) for process in running], _least)


def compared(times: Sequence[Sequence[int]], least: list[int]) -> float:
    """`unevenness` of the times of each processor; ``least`` holds the least so far, if any."""
    if not all(times):
        return 1.0
    least[:] = [min(map(min, [*times, least or times[0]]))]
    return max(sorted(each)[int(_SHARE * len(each)) - 1] for each in times) / least[0]


def _measure(processor: int) -> list[int]:
    """ns of each computation; none where SCHED_FIFO is refused."""
    os.sched_setaffinity(0, {processor})
    source = inspect.getsource(json.decoder)
    table = {str(i): {"x": [i, i + 0.5, str(i)], "y": {"z": (i,)}} for i in range(60)}
    try:
        highest = os.sched_get_priority_max(os.SCHED_FIFO)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(highest))
    except PermissionError:
        return []
    took = []
    for _ in range(_TIMES):
        began = time.perf_counter_ns()
        ast.parse(source)
        json.loads(json.dumps(copy.deepcopy(table)))
        took.append(time.perf_counter_ns() - began)
    return took


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(int(sys.argv[1]))))
