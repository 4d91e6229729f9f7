"""The table's stops, solved one by one; what is solved is kept, so that it may be interrupted."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.bench.least_stop.begin import case_of
from tests.bench.least_stop.cases import Point, Tear, solved
from tests.bench.least_stop.hold import POSITIONS, Hold, hold_at
from tests.bench.least_stop.model import Constants, Model
from tests.bench.least_stop.problem import Case
from tests.bench.least_stop.solve import Solver
from tonus.config.schema.root import Config


def holds(folder: Path) -> dict[Point, Hold]:
    """The controlled robot at every pose; kept in ``folder``."""
    kept = folder / "holds.json"
    if not kept.exists():
        found = [hold_at(position) for position in POSITIONS]
        rows = [{key: value.tolist() for key, value in asdict(h).items()} for h in found]
        kept.write_text(json.dumps(rows, indent=1) + "\n")
    rows = json.loads(kept.read_text())
    made = [Hold(**{key: np.array(value) for key, value in row.items()}) for row in rows]
    return dict(zip(POSITIONS, made, strict=True))


class Kept:
    """Stops of the shipped robot, in a folder."""

    def __init__(self, config: Config, folder: Path) -> None:
        assert config.lab is not None
        self._folder = folder
        self._geometry = config.robot.geometry
        self._speed = config.control.envelope.speed_limit
        model = Model(Constants.of(config.robot, config.lab))
        self._solver = Solver(model, config.control.tension.max)
        self._holds = holds(folder)

    def case(self, tear: Tear) -> Case:
        velocity = tear.velocity(self._geometry, self._speed)
        hold = self._holds[tear.position]
        return case_of(self._solver.model, self._geometry, hold, tear.cable, velocity)

    def keep(self, tear: Tear, start: str) -> str:
        """Solve, write the result beside the others and say it in a line."""
        fast, gentle = self._solver.solve(self.case(tear), start)
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
