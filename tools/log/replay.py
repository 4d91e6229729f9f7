"""Recorded inputs through a fresh control cycle: does it command again what it commanded then?

The comparison is of bits, not of numbers: `ControlCycle.step` is a pure function of its state and
its inputs, so that any difference means another program, another configuration or another input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.errors import ControllerError
from tonus.runtime.recording.keyframe import FROM_A_KEYFRAME, KeyframeError, restore
from tonus.runtime.recording.messages import KEYFRAME_TOPIC
from tonus.runtime.signals import TABLE, cycle_dtype
from tonus.runtime.states import Fault, Operator
from tonus.tools.errors import ToolError
from tonus.tools.log.attached import catalogue, configuration, played
from tonus.tools.log.decode import Column
from tonus.tools.log.log import TUNING, Log

TIMING = "/tonus/timing"
_TICK = "tick"
_IMAGE = {
    "/tonus/drives": (
        "axes",
        (
            *("angle", "torque", "sampled_ns", "doubt_ns"),
            *("statusword", "error_code", "age", "state"),
        ),
    ),
    "/tonus/force_cells": ("cells", ("age", "status")),
    "/tonus/tracker": ("tracker", ("position", "quaternion", "delay", "sequence", "fresh")),
}
"""Where the image's tables are recorded, under the names they have there."""
_NEEDED = (TIMING, "/tonus/state", *_IMAGE)
_WHAT_IF = (
    ("/tonus/drives", "torque_command"),
    ("/tonus/stiffness", "k_eq"),
    ("/tonus/wrench", "commanded"),
)

Progress = Callable[[int], None]
"""Receives the tick that has been reached."""


@dataclass(frozen=True)
class Difference:
    """One number that did not come out again."""

    tick: int
    topic: str
    field: str
    index: int
    """in its array; 0 for a scalar"""
    recorded: np.generic
    replayed: np.generic

    @property
    def place(self) -> str:
        return f"{self.topic}.{self.field}[{self.index}]"


@dataclass
class Replay:
    """What a replay found."""

    ticks: int = 0
    """compared"""
    first_tick: int | None = None
    last_tick: int | None = None
    keyframes: list[int] = field(default_factory=list)
    """ticks at which a recorded state was taken up"""
    unchecked: list[tuple[int, int]] = field(default_factory=list)
    """first and last tick of stretches that no state leads up to: records are missing before"""
    first: Difference | None = None
    differing: dict[str, int] = field(default_factory=dict)
    """ticks in which a signal was different, by topic.field"""
    changes: list[Change] = field(default_factory=list)
    same_state: int = 0
    """ticks in which another configuration was in the recorded state"""


@dataclass
class Change:
    """By how much another controller's commands differ, over all elements and ticks."""

    signal: str
    unit: str
    recorded: float
    """RMS"""
    replayed: float
    """RMS"""
    rms: float = 0.0
    """of the difference"""
    largest: float = 0.0
    at_tick: int = 0
    _count: int = 0

    def add(self, ticks: NDArray[Any], recorded: NDArray[Any], replayed: NDArray[Any]) -> None:
        shape = (len(ticks), -1)
        then, now = recorded.reshape(shape), replayed.reshape(shape)
        apart = np.abs(now - then)
        count, new = self._count, then.size
        for name, values in (("recorded", then), ("replayed", now), ("rms", apart)):
            total = getattr(self, name) ** 2 * count + float((values**2).sum())
            setattr(self, name, float(np.sqrt(total / (count + new))))
        worst = int(apart.max(axis=1).argmax())
        if not apart[worst].max() <= self.largest:
            self.largest, self.at_tick = float(apart[worst].max()), int(ticks[worst])
        self._count += new


def _in_step(log: Log, recorded: Config, other: Config) -> Config:
    """The other configuration with the sequence and the list of tunable parameters that the inputs
    belong to."""
    if other.control.rates.period != recorded.control.rates.period:
        raise ToolError(f"{log.path}: was recorded at another rate than {other.name} asks for")
    sequence = {"sequence": recorded.control.sequence}
    control = other.control.model_copy(update=sequence)
    tunable = {"tunable": recorded.operation.tunable}
    operation = other.operation.model_copy(update=tunable)
    return other.model_copy(update={"control": control, "operation": operation})


def replay(
    log: Log,
    *,
    other: Config | None = None,
    first: int | None = None,
    last: int | None = None,
    progress: Progress = lambda _: None,
) -> Replay:
    """Replay ticks ``first`` to ``last`` (all, if None) and compare every output; or, with an
    ``other`` configuration, sum up what that would have commanded on these inputs.

    The other one starts at the log's beginning, since a recorded state is not its own, and keeps
    the log's times for taring, referencing and lifting, since the inputs are of that sequence.
    """
    missing = [topic for topic in _NEEDED if topic not in log]
    if missing:
        raise ToolError(f"{log.path}: no {missing[0]} in it, so it cannot be replayed")
    return _Replayer(log, other, first, last, progress).run()


class _Replayer:
    def __init__(
        self,
        log: Log,
        other: Config | None,
        first: int | None,
        last: int | None,
        progress: Progress,
    ) -> None:
        self._log, self._other, self._progress = log, other, progress
        self._first = 0 if first is None else first
        self._last = np.iinfo(np.int64).max if last is None else last
        self._config = configuration(log)
        if other is not None:
            self._config = _in_step(log, self._config, other)
        self._reference = played(log).reference
        self._others = [scenario.reference for scenario in catalogue(log)]
        self._image = ProcessImage(self._config.robot.cables)
        self._topics = [topic for topic in TABLE if topic.name in log]
        self._cycle: ControlCycle | None = None
        self._from_a_keyframe = FROM_A_KEYFRAME.items() <= log.metadata.items()
        self._next: int | None = None if self._from_a_keyframe else 0
        """sequence number of the record that follows on the state; None: no state"""
        self._before = -1
        self._keyframes = {} if other else self._recorded_states()
        self.result = Replay()

    def run(self) -> Replay:
        start = max((tick for tick in self._keyframes if tick < self._first), default=None)
        if start is None:
            self._cycle = self._fresh()
        else:
            self._next = None
        for batch in self._batches():
            ticks = self._ticks(batch)
            if start is not None and ticks[-1] < start:
                continue
            if ticks[0] > self._last:
                break
            self._play(batch, ticks)
            self._progress(int(ticks[-1]))
        return self.result

    def _fresh(self) -> ControlCycle:
        config = self._config
        try:
            return ControlCycle(
                config.robot,
                config.control,
                config.tracker,
                self._reference,
                self._others,
                config.operation.tunable,
            )
        except ControllerError as error:
            raise ToolError(f"{self._log.path}: {error}") from error

    def _recorded_states(self) -> dict[int, bytes]:
        if KEYFRAME_TOPIC not in self._log or self._log[KEYFRAME_TOPIC].dtype.names is None:
            return {}
        return {int(row["tick"]): row["state"] for row in self._log[KEYFRAME_TOPIC]}

    def _batches(self) -> Iterator[dict[str, Column]]:
        """Cycle topics with their rows side by side: they are the members of one record."""
        names = [topic.name for topic in self._topics]
        for batch in self._log.batches(names):
            if not any(len(column.times) for column in batch.values()):
                continue
            if len(batch) < len(names):
                raise ToolError(f"{self._log.path}: not every file has the topics of a tick")
            sequence = batch[TIMING].sequence
            for column in batch.values():
                if column.messages.dtype.names is None or not np.array_equal(
                    column.sequence, sequence
                ):
                    raise ToolError(f"{self._log.path}: the topics of a tick do not fit together")
            yield batch

    def _ticks(self, batch: dict[str, Column]) -> NDArray[np.int64]:
        """Numbers (n,) of the batch's ticks; time only goes forward."""
        ticks = batch[TIMING].messages[_TICK].astype(np.int64)
        before = np.concatenate(([self._before], ticks[:-1]))
        wrong = np.flatnonzero(ticks <= before)
        if len(wrong):
            at = int(wrong[0])
            raise ToolError(f"{self._log.path}: tick {ticks[at]} comes after tick {before[at]}")
        self._before = int(ticks[-1])
        return ticks

    def _play(self, batch: dict[str, Column], ticks: NDArray[np.int64]) -> None:
        """Step through a batch, and compare what came out."""
        sequence = batch[TIMING].sequence
        out = np.zeros(len(ticks), cycle_dtype(self._config.robot.cables))
        done = np.zeros(len(ticks), bool)
        rows = self._inputs(batch)
        state = batch["/tonus/state"].messages
        operators = self._input(state, "/tonus/state", "operator", ())
        selects = self._input(state, "/tonus/state", "select", ())
        unguarded = self._input(state, "/tonus/state", "unguarded", ()).tolist()
        changes = self._changes(batch, len(ticks))
        failed = state["fault"] == Fault.CONTROL_FAILED
        for index, tick in enumerate(ticks.tolist()):
            if tick > self._last:
                break
            if self._next != sequence[index] or failed[index]:
                # Where control raised, the daemon's fallback commanded, which is no step.
                self._cycle, self._next = None, None
            if self._cycle is None:
                self._take_up(tick, int(sequence[index]))
                continue
            self._next = int(sequence[index]) + 1
            for table, row in rows:
                table[...] = row[index]
            self._image.unguarded = bool(unguarded[index] & 1)
            self._image.supervisor_ignored = bool(unguarded[index] & 2)
            operator = self._operator(int(operators[index]), tick)
            select = int(selects[index])
            change = changes[index]
            out[index] = self._cycle.step(self._image, tick, operator, select, change).data[0]
            done[index] = tick >= self._first
        if done.any():
            self._compare(batch, out, done, ticks)

    def _take_up(self, tick: int, sequence: int) -> None:
        """Where a record is missing, only a recorded state leads on: that after this tick."""
        state = self._keyframes.get(tick)
        begins = state is not None and sequence == 0 and self._from_a_keyframe
        if tick >= self._first and not begins:
            self._note_unchecked(tick)
        if state is None:
            return
        try:
            self._cycle = restore(state, self._fresh())
        except KeyframeError as error:
            raise ToolError(
                f"{self._log.path}: the keyframe of tick {tick}: {error}; replay from a keyframe "
                "with the version that recorded it"
            ) from error
        self._next = sequence + 1
        self.result.keyframes.append(tick)

    def _note_unchecked(self, tick: int) -> None:
        stretches = self.result.unchecked
        if stretches and stretches[-1][1] == tick - 1:
            stretches[-1] = (stretches[-1][0], tick)
        else:
            stretches.append((tick, tick))

    def _changes(self, batch: dict[str, Column], ticks: int) -> list[GainChange]:
        """Of tunable parameters; none in a log of before there were any."""
        if TUNING not in batch:
            return [NO_CHANGE] * ticks
        rows = batch[TUNING].messages
        numbers, values = (self._input(rows, TUNING, name, ()) for name in ("parameter", "value"))
        return list(map(GainChange, numbers.tolist(), values.tolist()))

    def _operator(self, number: int, tick: int) -> Operator:
        try:
            return Operator(number)
        except ValueError as error:
            raise ToolError(
                f"{self._log.path}: tick {tick} has operator command {number}, which there is not"
            ) from error

    def _inputs(self, batch: dict[str, Column]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Tables of the image, and what is to be put there in each tick."""
        pairs = []
        for topic, (name, fields) in _IMAGE.items():
            table, rows = getattr(self._image, name), batch[topic].messages
            pairs += [
                (table[each], self._input(rows, topic, each, table[each].shape)) for each in fields
            ]
        cells = batch["/tonus/force_cells"].messages
        force = self._image.cells["force"]
        pairs.append((force, self._input(cells, "/tonus/force_cells", "raw", force.shape)))
        return pairs

    def _input(
        self, rows: NDArray[Any], topic: str, name: str, shape: tuple[int, ...]
    ) -> NDArray[Any]:
        if name not in (rows.dtype.names or ()) or rows[name].shape[1:] != shape:
            raise ToolError(f"{self._log.path}: no {topic}.{name} as a replay needs it")
        return rows[name]

    def _compare(
        self,
        batch: dict[str, Column],
        out: NDArray[np.void],
        done: NDArray[np.bool_],
        ticks: NDArray[np.int64],
    ) -> None:
        result = self.result
        ticks = ticks[done]
        result.ticks += len(ticks)
        result.first_tick = int(ticks[0]) if result.first_tick is None else result.first_tick
        result.last_tick = int(ticks[-1])
        if self._other is not None:
            self._sum_up(batch, out[done], done, ticks)
            return
        found: Difference | None = None
        for topic in self._topics:
            recorded = batch[topic.name].messages[done]
            replayed = out[topic.name.rsplit("/", 1)[1]][done]
            for name in self._outputs(topic.name, recorded, replayed):
                unlike = _unlike(recorded[name], replayed[name])
                rows = np.flatnonzero(unlike.any(axis=1))
                if not len(rows):
                    continue
                signal = f"{topic.name}.{name}"
                result.differing[signal] = result.differing.get(signal, 0) + len(rows)
                row = int(rows[0])
                if found is None or ticks[row] < found.tick:
                    index = int(unlike[row].argmax())
                    then, now = (np.ravel(rows[name][row])[index] for rows in (recorded, replayed))
                    found = Difference(int(ticks[row]), topic.name, name, index, then, now)
        result.first = result.first or found

    def _outputs(
        self, topic: str, recorded: NDArray[np.void], replayed: NDArray[np.void]
    ) -> list[str]:
        """Signals that the log's version and this one have alike. When a tick ran is not the
        cycle's doing."""
        if topic == TIMING:
            return [_TICK]
        theirs, ours = recorded.dtype, replayed.dtype
        names = [name for name in ours.names or () if name in (theirs.names or ())]
        return [name for name in names if theirs[name] == ours[name]]

    def _sum_up(
        self,
        batch: dict[str, Column],
        out: NDArray[np.void],
        done: NDArray[np.bool_],
        ticks: NDArray[np.int64],
    ) -> None:
        then, now = batch["/tonus/state"].messages["state"][done], out["state"]["state"]
        self.result.same_state += int((then == now).sum())
        changes = {change.signal: change for change in self.result.changes}
        for topic in self._topics:
            for signal in topic.fields:
                if (topic.name, signal.name) not in _WHAT_IF:
                    continue
                name = f"{topic.name}.{signal.name}"
                if name not in changes:
                    changes[name] = Change(name, signal.unit, 0.0, 0.0)
                then = batch[topic.name].messages[signal.name][done]
                now = out[topic.name.rsplit("/", 1)[1]][signal.name]
                changes[name].add(ticks, then, now)
        self.result.changes = list(changes.values())


def _unlike(recorded: NDArray[Any], replayed: NDArray[Any]) -> NDArray[np.bool_]:
    """Elements (n, size) whose bits differ."""
    bits = np.dtype(f"u{recorded.dtype.itemsize}")
    shape = (len(recorded), -1)
    then, now = (np.ascontiguousarray(v).view(bits).reshape(shape) for v in (recorded, replayed))
    return np.asarray(then != now)
