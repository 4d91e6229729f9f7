"""A process that plays trials for a Dask worker, whose threads and loop are not a run's.

    python -m tonus.tools.study.remote

A line of JSON with a study and a trial on standard input, a row on standard output, until the
input ends.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.campaign.station import cause, watch
from tonus.tools.study.play import Row, failed
from tonus.tools.study.together import play_alone
from tonus.tools.study.trials import Trial

_COMMAND = (sys.executable, "-m", "tonus.tools.study.remote")
_own = threading.local()
"""each thread of a worker has a process of its own"""


def played(study: ParameterStudy, trial: Trial) -> Row:
    """In the process of this thread, which is started once, and again if it has died."""
    process: subprocess.Popen[str] | None = getattr(_own, "process", None)
    if process is None or process.poll() is not None:
        process = _own.process = subprocess.Popen(
            _COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        job = {"study": study.model_dump(mode="json"), "trial": asdict(trial)}
        process.stdin.write(json.dumps(job) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
    except BrokenPipeError:
        answer = ""
    if answer:
        row: Row = json.loads(answer)
        return row
    return failed(study, trial, cause(process.wait(), study.longest))


def main() -> None:
    """Play what is asked for. What a run prints would be taken for a row, and goes elsewhere."""
    rows = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        job = json.loads(line)
        study = ParameterStudy.model_validate(job["study"])
        watch(study.longest)
        with TemporaryDirectory(prefix="tonus-study-") as folder:
            row = play_alone(study, Trial(**job["trial"]), Path(folder) / "run")
        watch(0)
        rows.write(json.dumps(row) + "\n")
        rows.flush()


if __name__ == "__main__":
    main()
