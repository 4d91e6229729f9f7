"""The way up, tick by tick, and what counts as a fault in which state."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit import sequence_setup
from tests.unit.sequence_setup import CONTROL, PRETENSION_TICKS, N, Way
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.states import Fault, Operator, State, StopMode

UP = (State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)
MOVING = (State.PRETENSION, State.HOLD, State.ACTIVE)
FRESH = CONTROL.freshness.measurement_ticks


@pytest.fixture
def way() -> Way:
    return Way()


def armed(way: Way) -> Way:
    """In REFERENCING, its drives enabled."""
    way.to(State.REFERENCING)
    while not way.sequence.enabled:
        way.step()
    return way


def found(way: Way) -> list[tuple[Fault, int]]:
    """Every fault with its place, by number."""
    rows = np.argwhere(way.sequence.faults.found)
    return [(Fault(int(fault)), int(place) - 1) for fault, place in rows]


def test_before_the_first_tick_nothing_is_known(way: Way) -> None:
    sequence = way.sequence
    assert (sequence.state, sequence.stop_mode) == (State.OFF, StopMode.NONE)
    assert (sequence.enabled, sequence.referenced) == (False, False)
    assert (sequence.elapsed, sequence.stop_time, sequence.reason) == (0.0, 0.0, "")
    assert (sequence.load, sequence.aside, sequence.height) == (0.0, 0.0, 0.0)


def test_the_cells_are_zeroed_before_anything_else(way: Way) -> None:
    way.sensing.tare_time = 0.249
    way.steps(3)
    assert (way.tared, way.stated) == (3, [])
    way.sensing.tare_time = 0.25
    way.steps(1, after=State.STANDBY)
    assert way.stated == [CONTROL.sequence.tare]
    way.steps(5)
    assert way.tared == 4


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_offset_beyond_its_limit_is_a_bad_cell(way: Way, sign: float) -> None:
    way.sensing.tare_time, way.sensing.tare[[3, 5]] = 0.25, sign * 5.1
    way.steps(1, after=State.FAULT)
    assert (way.sequence.fault, way.sequence.where) == (Fault.CELL_BAD, 3)


def test_an_offset_at_its_limit_is_none(way: Way) -> None:
    way.sensing.tare_time, way.sensing.tare[:] = 0.25, 5.0
    way.steps(1, after=State.STANDBY)


def test_every_drive_has_to_be_enabled_in_time(way: Way) -> None:
    way.to(State.REFERENCING)
    way.obeying = False
    way.image.axes["state"] = AxisState.OPERATION_ENABLED
    way.image.axes["state"][[2, 6]] = AxisState.SWITCHED_ON
    way.steps(8)
    assert not way.sequence.enabled
    assert way.collected == 0
    way.steps(1, after=State.SAFE_STOP)
    assert (way.sequence.fault, way.sequence.where) == (Fault.ENABLE_TIMEOUT, 2)


def test_references_are_taken_after_a_while_and_for_a_while(way: Way) -> None:
    """Enabled at 2 ms; 4 ms to settle, 8 ms to average."""
    way.to(State.STANDBY).obeying = False
    way.step(Operator.ARM)
    way.step()
    assert not way.sequence.enabled
    assert way.sequence.straightening == -1.0
    way.image.axes["state"] = AxisState.OPERATION_ENABLED
    way.step()
    assert way.sequence.enabled
    shares = []
    for _ in range(3):
        shares.append(way.sequence.straightening)
        assert way.collected == 0
        way.step()
    assert shares == pytest.approx([0.0, 0.5, 1.0])
    assert way.sequence.straightening == 1.0
    assert way.collected == 0
    way.steps(8)
    assert (way.collected, way.concluded) == (8, [])
    assert not way.sequence.referenced
    way.steps(1, after=State.PRETENSION)
    assert (way.collected, way.concluded) == (9, [CONTROL.tension.referencing])
    assert way.sequence.referenced
    assert way.sequence.straightening == -1.0


def with_slack(way: Way, ticks: int, tension: float = 2.4) -> list[float]:
    """Shares of the tension asked for, from the tick on in which the drives are enabled."""
    armed(way)
    way.sensing.tension[[2, 6]] = tension
    shares = [way.sequence.straightening]
    for _ in range(ticks):
        way.step()
        shares.append(way.sequence.straightening)
    return shares


def test_tensions_wait_for_a_cable_that_is_slack(way: Way) -> None:
    """With 5 N of 12, from the second tick of slack beyond that on."""
    low = 5.0 / 12.0
    assert with_slack(way, 12) == pytest.approx([0.0, 0.5, 1.0, *([low] * 10)])
    assert way.collected == 0
    way.sensing.tension[2] = 2.5
    way.step()
    assert way.sequence.straightening == pytest.approx(low), "there is another"
    assert way.sequence.waits_for == [6]
    way.sensing.tension[6] = 2.5
    shares = []
    for _ in range(3):
        way.step()
        shares.append(way.sequence.straightening)
    assert shares == pytest.approx([low + 0.5, 1.0, 1.0])
    assert way.collected == 0
    way.steps(8)
    assert way.collected == 8
    way.steps(1, after=State.PRETENSION)


def test_a_cable_that_stays_slack_is_refused(way: Way) -> None:
    with_slack(way, 16)
    way.steps(1, after=State.SAFE_STOP)
    assert found(way) == [(Fault.REFERENCING_FAILED, 2), (Fault.REFERENCING_FAILED, 6)]
    assert way.sequence.reason == "it is still slack after 0.0155 s"
    assert way.sequence.waits_for == []
    assert (way.sequence.stop_mode, way.collected) == (StopMode.PASSIVE, 0)


def test_slack_that_is_taken_up_meanwhile_is_forgotten(way: Way) -> None:
    """By the cable, and by the next time that the robot is armed."""
    assert with_slack(way, 2) == pytest.approx([0.0, 0.5, 1.0])
    way.sensing.tension[:] = 30.0
    way.step()
    way.sensing.tension[3] = 0.0
    way.step()
    assert way.sequence.straightening == 1.0
    again = Way()
    with_slack(again, 6)
    again.sensing.tension[:] = 30.0
    again.step(Operator.STOP)
    again.to(State.STANDBY)
    armed(again)
    again.steps(12, after=State.PRETENSION)


def test_a_cable_at_half_of_the_tension_asked_for_is_not_slack(way: Way) -> None:
    assert with_slack(way, 4, tension=2.5) == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0])


def test_no_robot_waits_whose_log_is_from_before(monkeypatch: pytest.MonkeyPatch) -> None:
    before = CONTROL.sequence.model_copy(update={"take_up_s": 0.0, "slack_s": 0.0})
    monkeypatch.setattr(sequence_setup, "CONTROL", CONTROL.model_copy(update={"sequence": before}))
    assert with_slack(Way(), 4) == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0])


def test_references_that_are_refused_stop_the_robot(way: Way) -> None:
    way.refusal = "too far"
    armed(way)
    way.steps(12, after=State.SAFE_STOP)
    assert (way.sequence.fault, way.sequence.where) == (Fault.REFERENCING_FAILED, -1)
    assert way.sequence.reason == "too far"
    assert way.sequence.stop_mode is StopMode.PASSIVE
    assert not way.sequence.referenced


def test_tensions_grow_and_the_platform_is_lifted(way: Way) -> None:
    way.to(State.PRETENSION)
    tension, levels = CONTROL.tension, way.sequence.levels
    assert (levels.low, levels.high) == (tension.slack, tension.max)
    assert levels.level == tension.referencing
    way.steps(8)
    levels = way.sequence.levels
    assert levels.low == pytest.approx(0.5 * (tension.slack + tension.min))
    assert levels.level == pytest.approx(0.5 * (tension.referencing + tension.pre))
    for _ in range(2):
        way.steps(8)
        levels = way.sequence.levels
        assert (levels.low, levels.level) == pytest.approx((tension.min, tension.pre))
    way.steps(PRETENSION_TICKS - 25)
    way.steps(1, after=State.HOLD)
    way.steps(100)
    levels = way.sequence.levels
    assert (levels.low, levels.high, levels.level) == pytest.approx(
        (tension.min, tension.max, tension.pre)
    )


def test_elapsed_is_the_time_in_a_state(way: Way) -> None:
    way.to(State.HOLD)
    assert way.sequence.elapsed == 0.0
    way.steps(5)
    assert way.sequence.elapsed == pytest.approx(0.005)
    way.step(Operator.START)
    assert (way.state, way.sequence.elapsed) == (State.ACTIVE, 0.0)
    way.step(Operator.HOLD)
    assert way.state is State.HOLD


def test_what_begins_anew_with_referencing(way: Way) -> None:
    way.to(State.STANDBY)
    assert way.resets == []
    way.to(State.REFERENCING)
    assert sorted(way.resets) == ["envelope", "isolation", "referencing", "witness"]
    way.to(State.ACTIVE)
    assert len(way.resets) == 4


def test_which_states_enable_the_drives_and_which_regulate() -> None:
    for state in UP:
        way = Way().to(state)
        way.steps(3)
        assert way.sequence.stop_mode is StopMode.NONE
        wanted = AxisCommand.DISABLE if state is State.STANDBY else AxisCommand.ENABLE
        assert way.sequence.axis_command is wanted
        assert way.sequence.regulating is (state in MOVING)
        assert not way.sequence.descending
        assert way.sequence.passive_share == -1.0
        assert way.sequence.stiffness_cap == CONTROL.stiffness.maximum
    assert Way().sequence.axis_command is AxisCommand.DISABLE


# --- faults --------------------------------------------------------------------------------------


def test_an_emergency_stop_in_every_state() -> None:
    for state in (State.OFF, *UP):
        way = Way().to(state)
        way.step(Operator.ESTOP)
        assert (way.state, way.sequence.fault) == (State.FAULT, Fault.EMERGENCY_STOP)
        assert way.sequence.where == -1
        assert way.sequence.axis_command is AxisCommand.DISABLE
        assert not way.sequence.enabled
        assert way.sequence.stop_mode is StopMode.NONE


def test_in_an_emergency_stop_nothing_else_is_looked_for(way: Way) -> None:
    way.to(State.ACTIVE)
    way.image.cells["status"][2] = 1
    way.step(Operator.ESTOP)
    assert found(way) == [(Fault.EMERGENCY_STOP, -1)]


def test_only_a_reset_ends_a_fault_and_drives_are_reset_until_arming(way: Way) -> None:
    way.to(State.ACTIVE).step(Operator.ESTOP)
    way.image.cells["status"][2] = 1
    for operator in Operator:
        if operator is not Operator.RESET:
            assert not way.step(operator)
    assert found(way) == [(Fault.EMERGENCY_STOP, -1)], "nothing is looked for"
    way.image.cells["status"][2] = 0
    way.obeying = False
    way.image.axes["state"] = AxisState.FAULT
    way.step(Operator.RESET)
    assert (way.state, way.sequence.fault) == (State.STANDBY, Fault.NONE)
    assert way.sequence.axis_command is AxisCommand.RESET_FAULT
    way.steps(5)
    assert way.sequence.fault is Fault.NONE, "drives in a fault are being reset"
    way.image.axes["state"] = AxisState.SWITCH_ON_DISABLED
    way.step(Operator.ARM)
    assert way.state is State.REFERENCING
    assert way.sequence.axis_command is AxisCommand.ENABLE
    way.image.axes["state"][1] = AxisState.FAULT
    way.steps(1, after=State.SAFE_STOP)
    assert (way.sequence.fault, way.sequence.where) == (Fault.DRIVE_FAULT, 1)


def test_a_fault_after_a_reset_ends_the_resetting(way: Way) -> None:
    way.to(State.ACTIVE).step(Operator.ESTOP)
    way.step(Operator.RESET)
    way.fail(3)
    assert way.state is State.FAULT
    assert way.sequence.axis_command is AxisCommand.DISABLE


def test_a_reset_without_a_fault_resets_nothing(way: Way) -> None:
    way.to(State.STANDBY).step(Operator.RESET)
    assert way.sequence.axis_command is AxisCommand.DISABLE


def test_an_estimate_that_is_no_number(way: Way) -> None:
    way.to(State.ACTIVE).step(finite=False)
    assert (way.state, way.sequence.stop_mode) == (State.SAFE_STOP, StopMode.PASSIVE)
    assert (way.sequence.fault, way.sequence.where) == (Fault.NOT_FINITE, -1)


def test_silent_devices_and_impossible_ones_are_told_apart(way: Way) -> None:
    """All of them at once; the first is the reason."""
    way.to(State.ACTIVE)
    way.lost_axes, way.lost_cells = {0, 4, 7}, {0, 6, N}
    way.sensing.implausible_axes[4] = way.sensing.implausible_cells[6] = True
    way.step()
    assert found(way) == [
        (Fault.DRIVE_LOST, 0),
        (Fault.DRIVE_LOST, 7),
        (Fault.CELL_LOST, 0),
        (Fault.CELL_LOST, N),
        (Fault.IMPLAUSIBLE_DRIVE, 4),
        (Fault.IMPLAUSIBLE_CELL, 6),
    ]
    assert (way.sequence.fault, way.sequence.where) == (Fault.DRIVE_LOST, 0)
    assert np.flatnonzero(~way.sequence.carrying).tolist() == [0, 4, 6, 7]


def test_devices_have_time_to_appear(way: Way) -> None:
    way.lost_axes, way.lost_cells = {2}, {3}
    way.steps(9)
    way.steps(1, after=State.FAULT)
    assert found(way) == [(Fault.DRIVE_LOST, 2), (Fault.CELL_LOST, 3)]
    later = Way().to(State.STANDBY)
    later.lost_cells = {3}
    later.steps(1, after=State.FAULT)


@pytest.mark.parametrize("state", [AxisState.FAULT, AxisState.FAULT_REACTION_ACTIVE])
@pytest.mark.parametrize("axis", [0, N - 1])
def test_a_drive_in_fault_is_one_in_every_state(state: AxisState, axis: int) -> None:
    for at in (State.OFF, *UP):
        way = Way().to(at)
        way.image.axes["state"][axis] = state
        way.image.axes["age"][axis] = FRESH + 1
        way.step()
        assert (way.sequence.fault, way.sequence.where) == (Fault.DRIVE_FAULT, axis)


def test_a_drive_that_leaves_operation_enabled() -> None:
    """By a statusword that is fresh; every one of them."""
    for state in MOVING:
        for age, faults in ((FRESH, [1, N - 1]), (FRESH + 1, [])):
            way = Way().to(state)
            way.image.axes["state"][[1, N - 1]] = AxisState.QUICK_STOP_ACTIVE
            way.image.axes["age"] = age
            way.step()
            assert found(way) == [(Fault.DRIVE_FAULT, axis) for axis in faults]


def test_while_drives_are_being_enabled_or_disabled_they_may_be_in_any_state(way: Way) -> None:
    way.to(State.REFERENCING)
    way.obeying = False
    way.image.axes["state"][3] = AxisState.SWITCHED_ON
    way.steps(3)
    assert found(way) == []
    end = Way().stop()
    end.obeying = False
    end.steps(64)
    assert end.sequence.axis_command is AxisCommand.DISABLE
    end.image.axes["state"][3] = AxisState.SWITCHED_ON
    end.steps(3)
    assert found(end) == []


def test_defective_cells_in_every_state() -> None:
    for state in (State.OFF, *UP):
        way = Way().to(state)
        way.fail(0, 5, N)
        assert found(way) == [(Fault.CELL_BAD, cell) for cell in (0, 5, N)]
        assert way.state is not state


def test_drums_that_disobey_count_once_the_drives_are_enabled() -> None:
    for state in (State.STANDBY, State.REFERENCING, *MOVING):
        way = Way().to(state)
        way.disobedient = (Fault.DRUM_STUCK, 3)
        way.step()
        assert found(way) == ([(Fault.DRUM_STUCK, 3)] if state in MOVING else [])
    way = armed(Way())
    way.disobedient = (Fault.DRUM_STUCK, 3)
    way.step()
    assert found(way) == [(Fault.DRUM_STUCK, 3)]


def test_contradictions_and_bounds_count_while_the_platform_moves() -> None:
    """A contradiction first: it may be why a bound is met."""
    for state in UP:
        way = armed(Way()) if state is State.REFERENCING else Way().to(state)
        way.contradiction = (Fault.LENGTH_JUMP, 2)
        way.envelope.fault, way.envelope.where = Fault.OVER_TENSION, 6
        way.step()
        moving = state in MOVING
        assert found(way) == ([(Fault.OVER_TENSION, 6), (Fault.LENGTH_JUMP, 2)] if moving else [])
        assert (way.sequence.fault, way.sequence.where) == (
            (Fault.LENGTH_JUMP, 2) if moving else (Fault.NONE, -1)
        )


@pytest.mark.parametrize(
    ("shown", "fault"),
    [("unguarded", Fault.RELAY_SILENT), ("supervisor_ignored", Fault.SUPERVISOR_IGNORED)],
)
def test_an_armed_robot_that_the_supervisor_could_not_stop_stops(shown: str, fault: Fault) -> None:
    """Along the path, by a fault of no cable; a robot that is not armed has its self-test."""
    for state in (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE):
        way = Way().to(state)
        setattr(way.image, shown, True)
        way.step()
        assert way.state is State.SAFE_STOP
        assert found(way) == [(fault, -1)]
        passive = state is State.REFERENCING
        assert way.sequence.stop_mode is (StopMode.PASSIVE if passive else StopMode.ON_PATH)
    stopping = Way().stop()
    setattr(stopping.image, shown, True)
    stopping.step()
    assert found(stopping) == [(fault, -1)]
    assert stopping.sequence.stop_mode is StopMode.ON_PATH
    waiting = Way().to(State.STANDBY)
    setattr(waiting.image, shown, True)
    waiting.steps(3)
    assert found(waiting) == []


def test_a_fault_comes_before_the_operator(way: Way) -> None:
    way.to(State.HOLD)
    way.envelope.fault = Fault.CONTACT_LIMIT
    way.step(Operator.START)
    assert way.state is State.SAFE_STOP


def test_control_that_raised(way: Way) -> None:
    way.to(State.ACTIVE).steps(3)
    way.sequence.abandon("an exception", way.tick)
    sequence = way.sequence
    assert (sequence.state, sequence.stop_mode) == (State.SAFE_STOP, StopMode.PASSIVE)
    assert (sequence.fault, sequence.where) == (Fault.CONTROL_FAILED, -1)
    assert (sequence.reason, sequence.elapsed) == ("an exception", 0.0)
    for state in (State.OFF, State.STANDBY):
        sequence = Way().to(state).sequence
        sequence.abandon("an exception", 3)
        assert (sequence.state, sequence.stop_mode) == (State.FAULT, StopMode.NONE)


def test_an_emergency_stop_before_the_first_tick(way: Way) -> None:
    way.sequence.stop_before_ticks()
    assert (way.state, way.sequence.fault) == (State.FAULT, Fault.EMERGENCY_STOP)
    assert way.sequence.where == -1
