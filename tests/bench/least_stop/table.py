"""The table of all eight cables, from the solved ones and their mirror images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.bench.least_stop.cases import MOTIONS, Tear, solved, solved_as
from tests.bench.least_stop.grid import DELAY
from tests.bench.least_stop.hold import POSITIONS
from tests.bench.least_stop.problem import CONVERGED
from tonus.config.schema.least_stop import LeastStops
from tonus.config.schema.least_stop import Stop as Least
from tonus.config.schema.least_stop import Tear as Row
from tonus.config.schema.robot import Geometry

_HEAD = """\
# The lower bound of physics after a torn cable: per cable (0 to 7), pose and motion at the break,
# the optimum over the motors' torques. Written by make least-stop; method: docs/least_stop.md.
"""
MODEL = "tests/bench/least_stop: platform, seven elastic cables and drums; CasADi, IPOPT"


def best(folder: Path, tear: Tear) -> Least | None:
    """Of all starts; None where none converged. Peaks on the safe side: rounded up."""
    found = [each for each in _solutions(folder, tear) if each is not None]
    return min(found, key=lambda stop: stop.speed) if found else None


def _solutions(folder: Path, tear: Tear) -> Iterator[Least | None]:
    for path in sorted(folder.glob(f"{tear.name}_*.npz")):
        with np.load(path) as kept:
            good = max(kept["defects"]) < CONVERGED
            speed, tension = float(kept["speed"]), float(kept["tension"])
        yield Least(speed=_up(speed, 3), tension=_up(tension, 1)) if good else None


def _up(value: float, digits: int) -> float:
    return float(np.ceil(round(value * 10**digits, 3)) / 10**digits)


def missing(folder: Path) -> list[Tear]:
    return [tear for tear in solved() if best(folder, tear) is None]


def spread(folder: Path) -> list[float]:
    """How far the starts differ, as a share of the best, for every stop with several."""
    differences = []
    for tear in solved():
        found = [each.speed for each in _solutions(folder, tear) if each is not None]
        if len(found) > 1:
            differences.append(max(found) / min(found) - 1.0)
    return differences


def table(folder: Path, geometry: Geometry, speed_limit: float, date: str) -> LeastStops:
    rows = []
    for cable in range(len(geometry.frame)):
        for position in POSITIONS:
            stops = {}
            for motion in MOTIONS:
                stops[motion] = best(folder, solved_as(Tear(cable, position, motion), geometry))
            rows.append(Row(cable=cable, position=position, **stops))
    return LeastStops(
        computed=date, model=MODEL, delay=DELAY, speed_limit=speed_limit, tears=tuple(rows)
    )


def write(made: LeastStops, path: Path) -> None:
    """One line per cable and pose."""
    lines = [f"computed: {made.computed!r}", f"model: {made.model!r}"]
    lines += [f"delay: {made.delay}", f"speed_limit: {made.speed_limit}"]
    lines += ["tears:                 # position in m, speed in m/s, tension in N"]
    for row in made.tears:
        stops = ", ".join(
            f"{motion}: {{speed: {stop.speed}, tension: {stop.tension}}}"
            for motion, stop in ((m, getattr(row, m)) for m in MOTIONS)
            if stop is not None
        )
        lines.append(f"- {{cable: {row.cable}, position: {list(row.position)}, {stops}}}")
    path.write_text(_HEAD + "\n".join(lines) + "\n")
