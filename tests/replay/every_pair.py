"""``python -m tests.replay.every_pair``: each scenario with each controller, briefly, and replayed.
Exit code 1 if an output did not come out again."""

from __future__ import annotations

import itertools
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.composed import configured, virtual
from tonus.runtime.control.controllers import CONTROLLERS
from tonus.tools.log.replay import replay


def main() -> int:
    scenarios = sorted(path.stem for path in Path("config/scenarios").glob("*.yaml"))
    unequal = 0
    for scenario, controller in itertools.product(scenarios, CONTROLLERS):
        settings = {"control.controller": controller, "recording.raw_frames": False}
        config, played = configured(
            "config/direct.yaml", scenario, duration=0.2, overrides=settings
        )
        with tempfile.TemporaryDirectory() as folder:
            found = replay(virtual(config, played, Path(folder))[1])
        end = "bit-equal" if found.first is None else f"differs: {found.first}"
        unequal += found.first is not None
        print(f"{scenario:<20} {controller:<8} {found.ticks} ticks, {end}", flush=True)
    return 1 if unequal else 0


if __name__ == "__main__":
    sys.exit(main())
