"""A running daemon, seen through its rings: a second reader, which can write nothing in them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from pydantic import ValidationError

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.recording.payloads import EVENT
from tonus.runtime.recording.ring import RingError, RingReader
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.errors import ToolError
from tonus.tools.log.attached import from_yaml
from tonus.tools.run.description import read_description, running
from tonus.tools.view.moment import Array, Happening, Moment, Rows, Samples
from tonus.tools.view.settings import settings

if TYPE_CHECKING:
    from tonus.runtime.control.reference import Trajectory

_MOST = 4000
"""records taken at a time; what lies further back is left out of the plots"""
_EVENTS = 256
_PLAYING = frozenset({State.PRETENSION, State.HOLD, State.ACTIVE})


def newest_run() -> Path:
    """The ring folder of the daemon that started last. Raises `ToolError` where none runs."""
    found = running()
    if not found:
        raise ToolError(
            "no daemon is running; start one with: tonus run CONFIG --serve, or name a log: "
            "tonus view out/latest/run.mcap"
        )
    return found[-1]


class Live:
    """The run whose rings lie in ``rings``. Raises `ToolError`."""

    def __init__(self, rings: Path) -> None:
        self.rings = rings
        self.description = told = read_description(rings)
        try:
            self.config = Config.model_validate(from_yaml(told.config))
            self.scenario: Scenario | None = Scenario.model_validate(from_yaml(told.scenario))
            others = from_yaml(told.others)["scenarios"] if told.others else []
            self._scenarios = [self.scenario, *map(Scenario.model_validate, others)]
        except (yaml.YAMLError, ValidationError) as error:
            raise ToolError(
                f"{rings}: its configuration is of another version of Tonus; use that one"
            ) from error
        self.name = told.name
        self._trajectories: list[Trajectory] = []
        cables = self.config.robot.cables
        self._period = self.config.control.rates.period
        self._dtype, self._truth_dtype = cycle_dtype(cables), truth_dtype(cables)
        self._step = max(1, round(1.0 / (settings().sample_hz * self._period)))
        try:
            self._cycles = RingReader.look(rings / "cycle.ring")
            self._events = RingReader.look(rings / "events.ring")
        except (RingError, OSError) as error:
            raise ToolError(f"the run of {rings} is gone: {error}") from error
        # What happened before is told too, as far as the ring still has it.
        self._events.position = 0
        self._truths: RingReader | None = None
        self._true: Rows = np.empty(0, self._truth_dtype)
        self._newest: Rows = np.empty(0, self._dtype)
        self._reach_back()

    @property
    def is_over(self) -> bool:
        """Whether the daemon has ended; what it left in the rings can still be read."""
        number = self.rings.name.removeprefix("run-")
        return not self.rings.exists() or not Path("/proc", number).exists()

    def _reach_back(self) -> None:
        """Begin as far back as plots show, and the ring holds."""
        reach = int(settings().window_s / self._period)
        self._cycles.position = max(self._cycles.position - reach, 0)

    def advance(self) -> Moment:
        """Everything that was published since the last call, or the newest of it."""
        samples = self._samples()
        newest = self._newest
        time_s = float(newest["timing"]["tick"][0]) * self._period if len(newest) else 0.0
        return Moment(time_s, samples, newest, self._true, self._happenings())

    def ahead(self, seconds: float) -> Array:
        """Where the reference will go (n, 3), m, in so much scenario time, if it plays on as it is
        written; (0, 3) in a state that does not play it."""
        states = self._newest["state"]
        if not len(states) or int(states["state"][0]) not in _PLAYING:
            return np.empty((0, 3))
        if not self._trajectories:
            # Not before it is needed: the compiler takes a quarter of a second to import.
            from tonus.runtime.control.reference import trajectory

            self._trajectories = [trajectory(each.reference) for each in self._scenarios]
        played = self._trajectories[int(states["scenario"][0])]
        ahead = np.arange(0.0, seconds, 1.0 / settings().sample_hz)
        times = float(states["scenario_time"][0]) + ahead
        offsets = np.array([played(t)[0] for t in times])
        return np.asarray(self.config.robot.home + offsets)

    def _samples(self) -> Samples:
        parts = []
        while len(payload := self._cycles.drain(_MOST)[1]):
            rows = payload.view(self._dtype)[:, 0]
            parts.append(rows[rows["timing"]["tick"] % self._step == 0])
            self._newest = rows[-1:]
        rows = np.concatenate(parts) if parts else np.empty(0, self._dtype)
        times = rows["timing"]["tick"].astype(np.float64) * self._period
        return Samples(times, rows, self._truth_at(rows))

    def _truth_at(self, rows: Rows) -> Rows | None:
        """The lab's truth at cycle records (n,): what is newest, since both rings are looked at in
        the same moment; earlier ones follow from their stamps."""
        if self._truths is None:
            path = self.rings / "truth.ring"
            if not path.exists():
                return None
            try:
                self._truths = RingReader.look(path)
            except (RingError, OSError):
                return None
        stamps, payload = self._truths.drain(self._truths.capacity)
        if not len(stamps):
            return None
        true = payload.view(self._truth_dtype)[:, 0]
        self._true = true[-1:]
        at = np.searchsorted(stamps, rows["timing"]["due_ns"], "right") - 1
        return true[np.maximum(at, 0)] if (at >= 0).all() and len(at) else None

    def _happenings(self) -> list[Happening]:
        found = []
        while len(payload := self._events.drain(_EVENTS)[1]):
            for each in payload.view(EVENT).reshape(-1):
                name, where, text = (
                    each[key].decode(errors="replace") for key in ("name", "where", "text")
                )
                time_s = float(each["tick"]) * self._period
                found.append(Happening(time_s, int(each["level"]), name, where, text))
        return found

    def close(self) -> None:
        """Let go of the rings."""
        for reader in (self._cycles, self._events, self._truths):
            if reader is not None:
                reader.close()
