"""A keyframe holds all that a control cycle remembers, and nothing that its configuration says."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop import QUICK, ClosedLoop, configured

from tonus.runtime.cycle import ControlCycle
from tonus.runtime.recording.keyframe import Keyframe, KeyframeError, restore
from tonus.runtime.recording.taps import KEYFRAME_BYTES
from tonus.runtime.states import State


class Run:
    """A closed loop with a keyframe taken in each state, and the ticks after it."""

    def __init__(self) -> None:
        self.config, self.scenario = configured("sine_x", QUICK)
        loop = self.loop = ClosedLoop(self.config, self.scenario)
        loop.keep_inputs = True
        keyframe = Keyframe(loop.cycle)
        self.taken: dict[State, tuple[int, bytes]] = {}
        self.first = keyframe.take()
        for state in (State.STANDBY, State.REFERENCING, State.PRETENSION, State.ACTIVE):
            loop.until(state)
            loop.run(0.05)
            self.taken[loop.state] = loop.number, keyframe.take()
        loop.run(0.1)

    def fresh(self) -> ControlCycle:
        config = self.config
        return ControlCycle(config.robot, config.control, config.tracker, self.scenario.reference)


@pytest.fixture(scope="module")
def run() -> Run:
    return Run()


def test_a_restored_cycle_goes_on_as_the_first_did(run: Run) -> None:
    assert len(run.taken) >= 3
    for number, state in run.taken.values():
        cycle = restore(state, run.fresh())
        image = run.loop.image
        for tick in range(number, min(number + 300, len(run.loop.inputs))):
            given = run.loop.inputs[tick]
            image.axes[...], image.cells[...] = given.axes, given.cells
            image.tracker[...] = given.tracker
            record = cycle.step(image, tick, given.operator)
            assert record.data.tobytes() == run.loop._cycles[tick], tick


def test_rows_stay_rows_of_their_tables(run: Run) -> None:
    """A kernel is handed a table, and everything else reads a row of it."""
    restored = owners(restore(run.taken[State.ACTIVE][1], run.fresh()))
    assert owners(run.loop.cycle) == restored
    assert sum(owner != path for path, owner in restored.items()) > 50


def owners(cycle: ControlCycle) -> dict[str, str]:
    """The array that each array is part of, of those that can be reached, by their paths."""
    found: dict[str, Any] = {}
    seen: set[int] = set()

    def walk(path: str, value: object) -> None:
        if isinstance(value, np.ndarray):
            found[path] = value
        elif isinstance(value, tuple):
            for index, each in enumerate(value):
                walk(f"{path}.{index}", each)
        elif type(value).__module__.startswith("tonus.runtime") and id(value) not in seen:
            seen.add(id(value))
            for name, each in getattr(value, "__dict__", {}).items():
                walk(f"{path}.{name}", each)

    walk("", cycle)
    first: dict[int, str] = {}
    for path, value in found.items():
        first.setdefault(id(value), path)
    return {path: first[id(v.base if id(v.base) in first else v)] for path, v in found.items()}


def test_it_can_be_taken_again_from_the_restored_cycle(run: Run) -> None:
    _, state = run.taken[State.ACTIVE]
    fresh = run.fresh()
    initial = Keyframe(fresh)
    initial._owner = restore(state, fresh)
    assert initial.take() == state


def test_a_cycle_just_made_has_nothing_to_remember(run: Run) -> None:
    assert json.loads(run.first.partition(b"\n")[0])["state"] == {}


def test_the_configuration_is_not_part_of_it(run: Run) -> None:
    _, state = run.taken[State.ACTIVE]
    names = json.loads(state.partition(b"\n")[0])["state"]
    assert not [name for name in names if "gains" in name or "config" in name]
    assert len(state) < KEYFRAME_BYTES / 2


@settings(max_examples=60, derandomize=True, deadline=None)
@given(data=st.data())
def test_bytes_that_are_no_keyframe_are_refused_or_restored_and_never_run(
    run: Run, data: st.DataObject
) -> None:
    _, state = run.taken[State.ACTIVE]
    broken = bytearray(state)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, 6000))
        broken[at] = data.draw(st.integers(0, 255))
    try:
        restore(bytes(broken), run.fresh())
    except KeyframeError as told:
        line = str(told)
        only_one(line)


def only_one(line: str) -> None:
    assert line
    assert len(line) < 300


@pytest.mark.parametrize(
    "state", [b"", b"\n", b"{}\n", b'{"version":99,"state":{}}\n', b"\x80\x04cos\nsystem\n."]
)
def test_other_bytes_are_refused(run: Run, state: bytes) -> None:
    with pytest.raises(KeyframeError):
        restore(state, run.fresh())


def test_dictionaries_and_what_they_share_come_back() -> None:
    class Kept:
        def __init__(self) -> None:
            self.array = np.zeros(2)
            self.by_state = {State.HOLD: self.array, State.OFF: (1.0, None)}

    Kept.__module__ = "tonus.runtime.kept"
    kept = Kept()
    keyframe = Keyframe(kept)
    kept.array[:] = 7.0
    kept.by_state[State.OFF] = (-0.0, None)
    back = restore(keyframe.take(), Kept())
    assert back.by_state[State.HOLD] is back.array
    assert back.array.tolist() == [7.0, 7.0]
    assert str(back.by_state[State.OFF]) == "(-0.0, None)"


def test_what_cannot_be_kept_is_said_when_the_first_is_asked_for() -> None:
    class Odd:
        def __init__(self) -> None:
            self.file = np.random.default_rng(1)

    Odd.__module__ = "tonus.runtime.odd"
    with pytest.raises(KeyframeError, match="cannot hold a Generator"):
        Keyframe(Odd())
