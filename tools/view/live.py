"""A running daemon, seen through its rings: a second reader, which can write nothing in them."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from tonus.runtime.recording.payloads import EVENT
from tonus.runtime.recording.ring import RingError, RingReader
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.documents import from_yaml
from tonus.tools.errors import ToolError
from tonus.tools.run.description import read_description, running
from tonus.tools.view.moment import Array, Happening, Moment, Rows, Samples
from tonus.tools.view.settings import settings
from tonus.tools.view.shape import Shape

if TYPE_CHECKING:
    from tonus.config.schema.root import Config
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
            self._documents = from_yaml(told.config), from_yaml(told.scenario)
            self.shape = Shape.of(*self._documents)
        except (yaml.YAMLError, LookupError, TypeError, ValueError) as error:
            raise self._of_another_version() from error
        self.name = told.name
        self._trajectories: list[Trajectory] = []
        cables = self.shape.cables
        self._period = self.shape.period
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
        # The newest record first: there is a picture before the plots' past is read.
        self._cycles.position = max(self._cycles.position - 1, 0)
        self._looked = self._reached = False

    @property
    def is_over(self) -> bool:
        """Whether the daemon has ended; what it left in the rings can still be read."""
        number = self.rings.name.removeprefix("run-")
        return not self.rings.exists() or not Path("/proc", number).exists()

    @cached_property
    def config(self) -> Config:
        """Checked as a whole, which takes half a second. Raises `ToolError`."""
        from tonus.config.schema.root import Config

        try:
            return Config.model_validate(self._documents[0])
        except ValueError as error:
            raise self._of_another_version() from error

    def read_on(self) -> None:
        """Compute what `ahead` takes; in another thread than `advance`, because to load the
        compiler alone takes a quarter of a second. Raises `ToolError`."""
        from tonus.config.schema.scenario import Scenario
        from tonus.runtime.control.reference import trajectory

        others = self.description.others
        try:
            documents = [self._documents[1], *(from_yaml(others)["scenarios"] if others else [])]
            scenarios = map(Scenario.model_validate, documents)
            self._trajectories = [trajectory(each.reference) for each in scenarios]
        except (yaml.YAMLError, LookupError, TypeError, ValueError) as error:
            raise self._of_another_version() from error

    def _of_another_version(self) -> ToolError:
        return ToolError(
            f"{self.rings}: its configuration is of another version of Tonus; use that one"
        )

    def advance(self) -> Moment:
        """Everything that was published since the last call, or the newest of it. The second time
        begin as far back as plots show, and the ring holds."""
        jumped = self._looked and not self._reached
        if jumped:
            reach = int(settings().window_s / self._period)
            self._cycles.position = max(self._cycles.position - reach, 0)
        self._looked, self._reached = True, self._looked
        samples = self._samples()
        newest = self._newest
        time_s = float(newest["timing"]["tick"][0]) * self._period if len(newest) else 0.0
        return Moment(time_s, samples, newest, self._true, self._happenings(), jumped)

    def ahead(self, seconds: float) -> Array:
        """Where the reference will go (n, 3), m, in so much scenario time, if it plays on as it is
        written; (0, 3) in a state that does not play it, or before `read_on`."""
        states = self._newest["state"]
        if not len(states) or int(states["state"][0]) not in _PLAYING:
            return np.empty((0, 3))
        if not self._trajectories:
            return np.empty((0, 3))
        played = self._trajectories[int(states["scenario"][0])]
        ahead = np.arange(0.0, seconds, 1.0 / settings().sample_hz)
        times = float(states["scenario_time"][0]) + ahead
        offsets = np.array([played(t)[0] for t in times])
        return np.asarray(self.shape.home + offsets)

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
