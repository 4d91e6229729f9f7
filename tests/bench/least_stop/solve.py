"""Solve the stops one by one; what is solved already is kept, so that it may be interrupted."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.begin import case_of, damping, played, standing, still
from tests.bench.least_stop.cases import Tear, solved
from tests.bench.least_stop.hold import POSITIONS, Hold, hold_at
from tests.bench.least_stop.model import Constants, Model
from tests.bench.least_stop.problem import Case, Problem, Solution
from tonus.config.schema.root import Config

Array = NDArray[np.float64]
STARTS = ("still", "damping", "standing")
"""where the optimiser begins: nothing moves; drums that damp; drums that stand"""
SLOWER = 1.02
"""the peak tension is made small among stops with up to so many times the least peak speed"""
_ANY_SPEED = 5.0
"""m/s"""


def holds(folder: Path) -> dict[tuple[float, float, float], Hold]:
    """The controlled robot at every pose; kept in ``folder``."""
    kept = folder / "holds.json"
    if not kept.exists():
        found = [hold_at(position) for position in POSITIONS]
        rows = [{key: value.tolist() for key, value in asdict(h).items()} for h in found]
        kept.write_text(json.dumps(rows, indent=1) + "\n")
    rows = json.loads(kept.read_text())
    made = [Hold(**{key: np.array(value) for key, value in row.items()}) for row in rows]
    return dict(zip(POSITIONS, made, strict=True))


class Solver:
    """Model, programme and poses of the shipped robot."""

    def __init__(self, config: Config, folder: Path) -> None:
        assert config.lab is not None
        self._folder = folder
        self._geometry = config.robot.geometry
        self._speed = config.control.envelope.speed_limit
        self._tension = config.control.tension.max
        self.model = Model(Constants.of(config.robot, config.lab))
        self.problem = Problem(self.model)
        self._holds = holds(folder)

    def case(self, tear: Tear) -> Case:
        velocity = tear.velocity(self._geometry, self._speed)
        return case_of(self.model, self._geometry, self._holds[tear.position], tear.cable, velocity)

    def begin(self, case: Case, start: str) -> Array:
        """The vector of unknowns to start from; a law that ran away is cut to size."""
        if start == "still":
            return self.problem.unknowns(case, still(case))
        law = damping(12.0, 60.0) if start == "damping" else standing()
        return self.problem.unknowns(case, np.clip(played(self.model, case, law), -1.0, 1.0))

    def solve(self, tear: Tear, start: str) -> tuple[Solution, Solution]:
        """The stop of least peak speed, and the one of least peak tension about that fast."""
        case, problem = self.case(tear), self.problem
        fast = problem.solve(
            case,
            self.begin(case, start),
            weights=(2.0, 0.0),
            speed_limit=_ANY_SPEED,
            tension_limit=self._tension,
        )
        gentle = problem.solve(
            case,
            fast.unknowns,
            weights=(0.0, 0.3),
            speed_limit=SLOWER * fast.peak_speed,
            tension_limit=self._tension,
        )
        return fast, gentle

    def keep(self, tear: Tear, start: str) -> str:
        """Solve, write the result beside the others and say it in a line."""
        fast, gentle = self.solve(tear, start)
        np.savez_compressed(
            self._folder / f"{tear.name}_{start}.npz",
            speed=fast.peak_speed,
            tension=gentle.peak_tension,
            defects=[fast.defect, gentle.defect],
            iterations=[fast.iterations, gentle.iterations],
            fast=fast.unknowns,
            gentle=gentle.unknowns,
        )
        done = "" if fast.converged and gentle.converged else "  NOT CONVERGED"
        return (
            f"cable {tear.cable} at {tear.position} {tear.motion:7s} from {start:8s}: "
            f"{fast.peak_speed:.4f} m/s {gentle.peak_tension:6.1f} N, "
            f"{fast.iterations}+{gentle.iterations} iterations{done}"
        )

    def missing(self, start: str, motions: tuple[str, ...]) -> list[Tear]:
        return [
            tear
            for tear in solved()
            if tear.motion in motions and not (self._folder / f"{tear.name}_{start}.npz").exists()
        ]
