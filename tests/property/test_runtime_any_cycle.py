"""Whatever devices report and operators ask, the tick keeps what it promises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from loop import not_finite
from statue import CABLES, CELLS, CONFIG, CONTROL, Statue

from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.states import ARMED, TRANSITIONS, Fault, Operator, State, StopMode

FRESH, STALE = CONTROL.freshness.measurement_ticks, CONTROL.freshness.stale_stop_ticks
TENSION, LAW, PERIOD = CONTROL.tension, CONTROL.stiffness, CONTROL.rates.period
MOTOR = CONFIG.robot.motor
TORQUE_LIMIT = MOTOR.current_limit * MOTOR.torque_constant * CONFIG.robot.gearbox.ratio
MOVES = {(before, after) for (before, _), after in TRANSITIONS.items()}
ages = st.sampled_from([0, 0, 0, 0, 1, FRESH, FRESH + 1, STALE, STALE + 1, 60_000])


@dataclass
class Trouble:
    """What differs from a quiet robot for some ticks."""

    ticks: int
    operator: Operator
    axis_age: list[int]
    cell_age: list[int]
    states: dict[int, AxisState]
    force: list[float]
    wound: list[float]
    seen: tuple[float, float, float]
    status: int


def rows(strategy: st.SearchStrategy[float], count: int) -> st.SearchStrategy[list[float]]:
    return st.lists(strategy, min_size=count, max_size=count)


def aged(count: int) -> st.SearchStrategy[list[int]]:
    """Everything fresh, one row old, or any mixture."""
    one = st.tuples(st.integers(0, count - 1), st.integers(0, STALE + 2)).map(
        lambda pick: [pick[1] if row == pick[0] else 0 for row in range(count)]
    )
    return st.just([0] * count) | one | st.lists(ages, min_size=count, max_size=count)


troubles = st.builds(
    Trouble,
    ticks=st.integers(1, 40),
    operator=st.sampled_from(Operator),
    axis_age=aged(CABLES),
    cell_age=aged(CELLS),
    states=st.just({}) | st.dictionaries(st.integers(0, 7), st.sampled_from(AxisState), max_size=2),
    force=st.just([0.0] * CELLS) | rows(st.floats(-500.0, 500.0), CELLS),
    wound=st.just([0.0] * CABLES) | rows(st.floats(-0.5, 0.5), CABLES),
    seen=st.just((0.0, 0.0, 0.0)) | st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    status=st.sampled_from([-1, -1, -1, -1, 0, 8]),
)
starts = st.sampled_from(
    [State.OFF, State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE]
)


def disturb(statue: Statue, trouble: Trouble) -> None:
    image = statue.report()
    image.axes["age"], image.cells["age"] = trouble.axis_age, trouble.cell_age
    for axis, state in trouble.states.items():
        image.axes["state"][axis] = state
    image.cells["force"] += trouble.force
    image.axes["angle"] += trouble.wound
    image.tracker["position"] += trouble.seen
    if trouble.status >= 0:
        image.cells["status"][trouble.status] = 1


class Silence:
    """How many ticks in a row each device brought nothing new or nothing fresh, counted apart from
    the cycle: a sample that has aged by a tick is the one of the tick before."""

    def __init__(self) -> None:
        self.axes, self.cells = np.zeros(CABLES, int), np.zeros(CELLS, int)
        self._before = np.zeros(CABLES, int), np.zeros(CELLS, int)

    def count(self, statue: Statue) -> Silence:
        ages = (statue.image.axes["age"].astype(int), statue.image.cells["age"].astype(int))
        nothing = [
            (age > last) | (age > FRESH) for age, last in zip(ages, self._before, strict=True)
        ]
        self.axes = np.where(nothing[0], self.axes + 1, 0)
        self.cells = np.where(nothing[1], self.cells + 1, 0)
        self._before = ages
        return self


def check(
    statue: Statue, before: State, stiffness: float, operator: Operator, silence: Silence
) -> None:
    image, record, state = statue.image, statue.record, statue.state
    torque, command = image.commands["torque"], image.commands["command"]
    # A passive stop needs no cell: each drum damps its own rate.
    passive = statue.cycle.sequence.stop_mode is StopMode.PASSIVE
    fresh = (image.axes["age"] <= FRESH) & ((image.cells["age"][:CABLES] <= FRESH) | passive)
    assert np.isfinite(torque).all()
    assert np.abs(torque).max() <= TORQUE_LIMIT
    assert (torque[~fresh] == 0.0).all()
    assert (before, state) in MOVES or before is state
    sequence = statue.cycle.sequence
    if state not in ARMED:
        assert not torque.any()
        assert not (command == AxisCommand.ENABLE).any()
    if operator is Operator.ESTOP:
        assert state is State.FAULT
        assert (command == AxisCommand.DISABLE).all()
    if state is State.FAULT:
        assert sequence.fault is not Fault.NONE
    if (silence.axes > STALE).any() and before in ARMED:
        assert state not in (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)
    if state in (State.HOLD, State.ACTIVE):
        reference = record.tension.reference
        assert (reference >= TENSION.min).all()
        assert (reference <= TENSION.max).all()
    if sequence.regulating:
        lost = (silence.axes > STALE) | (silence.cells[:CABLES] > STALE)
        assert (record.tension.reference[lost] == 0.0).all()
        now = float(record.stiffness.k_eq)
        assert LAW.minimum <= now <= LAW.maximum
        assert now <= max(stiffness, LAW.minimum) + LAW.rise_rate * PERIOD * (1.0 + 1e-9)
        assert 0.0 <= float(record.envelope.progress) <= 1.0


@settings(max_examples=120, deadline=None, derandomize=True)
@given(starts, st.lists(troubles, min_size=1, max_size=4))
def test_no_history_breaks_a_promise(start: State, history: list[Trouble]) -> None:
    statue, silence = Statue().until(start), Silence()
    for trouble in history:
        for n in range(trouble.ticks):
            disturb(statue, trouble)
            operator = trouble.operator if n == 0 else Operator.NONE
            before, stiffness = statue.state, float(statue.record.stiffness.k_eq)
            statue.step(operator)
            check(statue, before, stiffness, operator, silence.count(statue))
    assert not_finite(statue.record.data) == []


@settings(max_examples=15, deadline=None, derandomize=True)
@given(starts, st.lists(troubles, min_size=1, max_size=2))
def test_once_left_alone_a_robot_comes_to_rest(start: State, history: list[Trouble]) -> None:
    """From anything, a stop and quiet devices lead to STANDBY or FAULT with the drives off."""
    statue = Statue().until(start)
    for trouble in history:
        disturb(statue, trouble)
        statue.step(trouble.operator)
    for n in range(800):
        statue.report()
        statue.step(Operator.STOP if n == 0 else Operator.NONE)
    assert statue.state in (State.STANDBY, State.FAULT)
    assert not statue.image.commands["torque"].any()
