"""Which stop is made: the best one whose assumptions hold, and never a better one again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from statue import CABLES, CONFIG, CONTROL, SCENARIO, Statue

from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.control.controllers.base import Controller
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.safety.faults import Faults
from tonus.runtime.safety.sequence import FEWEST
from tonus.runtime.states import Fault, Operator, State, StopMode

STALE = CONTROL.freshness.stale_stop_ticks
RADIUS = CONFIG.robot.drum.radius
Spoil = Callable[[ProcessImage], None]
Array = NDArray[np.float64]


def defective(*cells: int) -> Spoil:
    def spoil(image: ProcessImage) -> None:
        image.cells["status"][list(cells)] = 1

    return spoil


def contact(image: ProcessImage) -> None:
    image.cells["force"][8] = 30.0


def go_on(
    statue: Statue, spoil: Spoil | None = None, ticks: int = 1, operator: Operator = Operator.NONE
) -> Statue:
    for _ in range(ticks):
        statue.report()
        if spoil is not None:
            spoil(statue.image)
        statue.step(operator)
    return statue


def mode(statue: Statue) -> StopMode:
    recorded = StopMode(int(statue.record.state.stop_mode))
    assert recorded is statue.cycle.sequence.stop_mode, "the log says what is done"
    return recorded


def given_up(statue: Statue) -> list[int]:
    return np.flatnonzero(statue.record.state.failed).tolist()


def test_there_is_no_mode_outside_a_stop() -> None:
    for state in (State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE):
        assert mode(Statue().until(state)) is StopMode.NONE


def test_with_all_cables_a_stop_keeps_to_the_path() -> None:
    for state in (State.PRETENSION, State.HOLD, State.ACTIVE):
        statue = go_on(Statue().until(state), operator=Operator.STOP)
        assert mode(statue) is StopMode.ON_PATH
        assert given_up(statue) == []
        statue.until(State.STANDBY)
        assert mode(statue) is StopMode.NONE


def test_a_fault_of_a_cable_is_a_descent_with_the_others() -> None:
    statue = go_on(Statue().until(State.ACTIVE), defective(4))
    assert (mode(statue), given_up(statue)) == (StopMode.DESCENT, [4])
    reference = statue.record.tension.reference
    assert reference[4] == 0.0
    assert np.delete(reference, 4).min() >= CONTROL.stop.least_tension
    assert reference.max() <= CONTROL.stop.most_tension


def test_a_fault_in_a_stop_changes_it_at_once_and_the_first_stays_the_reason() -> None:
    statue = go_on(Statue().until(State.ACTIVE), contact, 20)
    assert mode(statue) is StopMode.ON_PATH
    go_on(statue, defective(4))
    sequence = statue.cycle.sequence
    assert (mode(statue), given_up(statue)) == (StopMode.DESCENT, [4])
    assert sequence.fault is Fault.CONTACT_LIMIT
    assert sequence.faults.at(Fault.CELL_BAD, 4)
    assert statue.record.tension.reference[4] == 0.0


def test_a_second_cable_in_a_stop_is_given_up_as_well() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(1))
    go_on(statue, defective(6))
    assert given_up(statue) == [1, 6]
    assert statue.cycle.sequence.where == 1
    assert not statue.record.tension.reference[[1, 6]].any()


def test_a_cable_that_comes_back_in_a_stop_is_not_used_again() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(4))
    go_on(statue, ticks=20)
    assert (mode(statue), given_up(statue)) == (StopMode.DESCENT, [4])
    assert statue.record.tension.reference[4] == 0.0


def test_with_too_few_cables_left_it_is_passive() -> None:
    most = range(CABLES - FEWEST)
    assert mode(go_on(Statue().until(State.HOLD), defective(*most))) is StopMode.DESCENT
    more = range(CABLES - FEWEST + 1)
    statue = go_on(Statue().until(State.HOLD), defective(*more))
    assert mode(statue) is StopMode.PASSIVE


@pytest.mark.parametrize(
    ("fewest", "stop"), [(7, StopMode.PASSIVE), (6, StopMode.DESCENT), (5, StopMode.DESCENT)]
)
def test_after_a_contradiction_it_is_passive_with_fewer_than_seven(
    fewest: int, stop: StopMode
) -> None:
    """Or than is configured. An encoder that jumps, then a cell that reports its own defect."""
    doubted = CONTROL.stop.model_copy(update={"fewest_doubted": fewest})
    control = CONTROL.model_copy(update={"stop": doubted})
    cycle = ControlCycle(CONFIG.robot, control, CONFIG.tracker, SCENARIO.reference)
    statue = Statue(cycle).until(State.HOLD)

    def slip(image: ProcessImage) -> None:
        image.axes["angle"][2] += 0.25

    go_on(statue, slip, 10)
    assert statue.cycle.sequence.faults.contradicted
    assert (mode(statue), given_up(statue)) == (StopMode.DESCENT, [2])
    go_on(statue, defective(5))
    assert (mode(statue), given_up(statue)) == (stop, [2, 5])


def test_before_the_cables_are_referenced_it_is_passive() -> None:
    statue = Statue().until(State.REFERENCING)
    while not statue.cycle.sequence.enabled:
        go_on(statue)
    go_on(statue, operator=Operator.STOP)
    assert mode(statue) is StopMode.PASSIVE


def test_a_passive_stop_needs_no_cell_and_damps_each_drum_by_its_own_rate() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(*range(8)))
    assert mode(statue) is StopMode.PASSIVE
    stop = CONTROL.stop
    go_on(statue, ticks=50)
    angle = statue.image.axes["angle"].copy()
    speed = -0.2  # m/s, reeling out
    for n in range(1, 30):
        turned = angle + np.arange(CABLES) * 0.1 * speed / RADIUS * n * CONTROL.rates.period

        def spoil(image: ProcessImage, turned: np.ndarray = turned) -> None:
            image.axes["angle"] = turned
            image.cells["force"] = np.nan

        go_on(statue, spoil)
    rate = np.arange(CABLES) * 0.1 * speed
    wanted = RADIUS * (stop.passive_tension - stop.passive_damping * rate)
    np.testing.assert_allclose(statue.image.commands["torque"], wanted, rtol=1e-3)


def test_a_drum_that_does_not_do_what_its_torque_says_gets_none_in_a_passive_stop() -> None:
    """With a reversed motor the damping would drive it."""
    statue = go_on(Statue().until(State.HOLD), defective(*range(8)))
    assert mode(statue) is StopMode.PASSIVE
    statue.cycle.sequence.faults.add(Fault.DRUM_TORQUE, 2)
    go_on(statue)
    torque = statue.image.commands["torque"]
    assert torque[2] == 0.0
    assert (np.delete(torque, 2) > 0.0).all()


def test_a_passive_stop_lets_go_only_after_rest_and_then_disables() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(*range(8)))
    enabled = 0
    while statue.state is State.SAFE_STOP:
        go_on(statue)
        enabled += int((statue.image.commands["command"] == AxisCommand.ENABLE).all())
    least = (CONTROL.stop.rest_s + CONTROL.sequence.stop_s) / CONTROL.rates.period
    assert enabled >= round(least) - 2
    assert enabled * CONTROL.rates.period < CONTROL.stop.passive_s
    assert statue.state is State.FAULT


def test_drums_go_on_damping_after_a_passive_stop_has_let_go() -> None:
    """A platform that still hangs then sinks: without a torque it would fall."""
    statue = go_on(Statue().until(State.HOLD), defective(*range(8)))
    while not statue.cycle.sequence.releasing:
        go_on(statue)
    rounds = round(CONTROL.sequence.stop_s / CONTROL.rates.period)
    angle, speed = statue.image.axes["angle"].copy(), -0.1  # m/s, reeling out
    for n in range(1, rounds + 100):

        def spoil(image: ProcessImage, turned: float = speed / RADIUS * n) -> None:
            image.axes["angle"] = angle + turned * CONTROL.rates.period

        go_on(statue, spoil)
    assert statue.cycle.sequence.passive_share == 0.0
    assert (statue.image.commands["command"] == AxisCommand.ENABLE).all()
    wanted = -RADIUS * CONTROL.stop.passive_damping * speed
    np.testing.assert_allclose(statue.image.commands["torque"], wanted, rtol=1e-2)
    still = statue.image.axes["angle"].copy()

    def stand(image: ProcessImage) -> None:
        image.axes["angle"] = still

    waited = round((CONTROL.stop.rest_s + 0.05) / CONTROL.rates.period)
    assert go_on(statue, stand, waited).state is State.FAULT


def test_a_descent_that_has_landed_eases_its_tensions_before_it_disables() -> None:
    """Cables that lose all torque at once throw what still hangs in them."""
    statue = go_on(Statue().until(State.HOLD), defective(0))
    sequence = statue.cycle.sequence
    shares: list[float] = []
    enabled = 0
    for _ in range(60_000):
        if statue.state is not State.SAFE_STOP or mode(statue) is not StopMode.DESCENT:
            break
        # The statue stays where it is; its height is said to be that of the cradle.
        sequence.height = 0.0
        if sequence.releasing:
            shares.append(sequence.passive_share)
            enabled += int((statue.image.commands["command"] == AxisCommand.ENABLE).all())
        go_on(statue)
    assert statue.state is State.FAULT
    steps = -np.diff(shares)
    assert shares[0] > 0.99
    assert shares[-1] == 0.0
    assert (steps >= 0.0).all()
    assert steps.max() < 2.0 * CONTROL.rates.period / CONTROL.sequence.stop_s
    least = (CONTROL.stop.rest_s + CONTROL.sequence.stop_s) / CONTROL.rates.period
    assert enabled >= round(least) - 2


def test_a_report_is_no_contradiction_that_excludes() -> None:
    faults = Faults(CONFIG.robot)
    assert faults.add(Fault.LENGTH_DRIFT, 1, exclude=False)
    assert faults.add(Fault.CABLE_TORN, 1)
    assert not faults.contradicted, "known for certain"
    assert faults.add(Fault.DRUM_TORQUE, 2)
    assert faults.contradicted
    faults.reset()
    assert not faults.contradicted


def test_drums_that_never_stand_are_let_go_in_the_end() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(*range(8)))
    angle, ticks = statue.image.axes["angle"].copy(), 0
    swing = 2.0 * CONTROL.stop.passive_speed / RADIUS * CONTROL.rates.period

    while statue.state is State.SAFE_STOP:
        ticks += 1

        def spoil(image: ProcessImage, off: float = swing * ticks) -> None:
            image.axes["angle"] = angle + off

        go_on(statue, spoil)
        assert ticks < 20_000
    stop = CONTROL.stop.passive_s + CONTROL.sequence.stop_s + CONTROL.stop.landing_s
    assert ticks == pytest.approx(stop / CONTROL.rates.period, abs=5)


def test_no_fault_leads_back_to_a_better_stop() -> None:
    statue = go_on(Statue().until(State.ACTIVE), contact, 20)
    spoils = (None, defective(0), None, contact, defective(*range(8)), None, defective(3), contact)
    seen = [mode(go_on(statue, spoil, 2)) for spoil in spoils]
    assert seen == sorted(seen)
    assert set(seen) == {StopMode.ON_PATH, StopMode.DESCENT, StopMode.PASSIVE}


@pytest.mark.parametrize("row", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_a_number_is_a_passive_stop(
    row: int, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A single one of a controller's wrench, found where the drums' motion is computed from it."""
    statue = Statue().until(State.HOLD)
    wrench = Controller.wrench

    def spoilt(controller: Controller, *given: Any) -> Array:
        values = wrench(controller, *given).copy()
        values[row] = value
        return values

    monkeypatch.setattr(Controller, "wrench", spoilt)
    go_on(statue)
    assert np.isfinite(statue.image.commands["torque"]).all()
    go_on(statue)
    assert (statue.cycle.sequence.fault, mode(statue)) == (Fault.NOT_FINITE, StopMode.PASSIVE)
    assert (statue.image.commands["command"] == AxisCommand.ENABLE).all()
    assert np.isfinite(statue.image.commands["torque"]).all()


def test_after_a_reset_the_robot_is_whole_again() -> None:
    statue = go_on(Statue().until(State.HOLD), defective(4)).until(State.FAULT)
    go_on(statue, ticks=5)
    go_on(statue, operator=Operator.RESET)
    assert given_up(statue) == []
    statue.until(State.ACTIVE)
    assert (statue.record.tension.reference >= CONTROL.tension.min).all()
    assert mode(go_on(statue, operator=Operator.STOP)) is StopMode.ON_PATH
