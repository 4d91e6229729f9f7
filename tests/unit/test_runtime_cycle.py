"""The whole tick: what it does when devices fall silent, fail or lie, and that it is a function of
its inputs alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from loop import QUICK, Array, ClosedLoop, Trace, configured, not_finite
from statue import CONFIG, CONTROL, REST, SCENARIO, Statue

from tonus.config.schema.lab import LabScript, Load, LoadPoint
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.safety.drum_observer import DrumObserver
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.safety.witness import Witness
from tonus.runtime.signals import Solver
from tonus.runtime.states import Fault, Operator, State, StopMode

FRESH, STALE = CONTROL.freshness.measurement_ticks, CONTROL.freshness.stale_stop_ticks
TENSION, LAW = CONTROL.tension, CONTROL.stiffness
MOTOR = CONFIG.robot.motor
TORQUE_LIMIT = MOTOR.current_limit * MOTOR.torque_constant * CONFIG.robot.gearbox.ratio
Spoil = Callable[[ProcessImage], None]


def go_on(statue: Statue, spoil: Spoil, ticks: int = 1) -> Statue:
    """Some ticks in which the devices say something else."""
    for _ in range(ticks):
        statue.report()
        spoil(statue.image)
        statue.step()
    return statue


def end(statue: Statue, spoil: Spoil, ticks: int = 800) -> tuple[State, Fault, int]:
    """After a stop that has waited twice for drums at rest."""
    go_on(statue, spoil, ticks)
    sequence = statue.cycle.sequence
    assert not statue.image.commands["torque"].any()
    assert (statue.image.commands["command"] == AxisCommand.DISABLE).all()
    return sequence.state, sequence.fault, sequence.where


def aged(table: str, row: int, age: int) -> Spoil:
    def spoil(image: ProcessImage) -> None:
        getattr(image, table)["age"][row] = age

    return spoil


@pytest.mark.parametrize("table", ["axes", "cells"])
def test_a_measurement_beyond_its_age_carries_no_torque(table: str) -> None:
    statue = Statue().until(State.HOLD)
    go_on(statue, aged(table, 3, FRESH))
    assert (statue.image.commands["torque"] != 0.0).all()
    go_on(statue, aged(table, 3, FRESH + 1), 3)
    torque, reference = statue.image.commands["torque"], statue.record.tension.reference
    assert torque[3] == 0.0
    assert (np.delete(torque, 3) != 0.0).all()
    assert (reference >= TENSION.min).all(), "a gap shifts no tension to the other cables"
    assert statue.at(State.HOLD)
    go_on(statue, lambda image: None)
    assert statue.image.commands["torque"][3] != 0.0
    assert statue.record.tension.reference[3] >= TENSION.min


@pytest.mark.parametrize(
    ("table", "row", "fault"),
    [("axes", 5, Fault.DRIVE_LOST), ("cells", 2, Fault.CELL_LOST), ("cells", 8, Fault.CELL_LOST)],
)
def test_a_device_silent_for_too_long_stops_the_robot(table: str, row: int, fault: Fault) -> None:
    statue = Statue().until(State.ACTIVE)
    go_on(statue, aged(table, row, STALE), STALE)
    assert statue.at(State.ACTIVE)
    go_on(statue, aged(table, row, STALE + 1))
    assert statue.at(State.SAFE_STOP)
    others = np.delete(statue.image.commands["torque"], row if row < 8 else [])
    assert (others != 0.0).all(), "the stop is controlled, not a collapse"
    given_up = np.flatnonzero(statue.record.tension.reference == 0.0).tolist()
    assert given_up == ([row] if row < 8 else [])
    assert end(statue, aged(table, row, STALE + 1)) == (State.FAULT, fault, row)


def test_an_emergency_stop_ends_a_reset() -> None:
    statue = Statue().until(State.STANDBY)
    for operator in (Operator.ESTOP, Operator.RESET, Operator.ESTOP):
        statue.report()
        statue.step(operator)
    assert statue.at(State.FAULT)
    assert (statue.image.commands["command"] == AxisCommand.DISABLE).all()


def test_an_emergency_stop_disables_everything_in_the_same_tick() -> None:
    for state in (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP):
        statue = Statue().until(state)
        statue.report()
        statue.step(Operator.ESTOP)
        assert statue.at(State.FAULT)
        assert statue.cycle.sequence.fault is Fault.EMERGENCY_STOP
        assert (statue.image.commands["command"] == AxisCommand.DISABLE).all()
        assert not statue.image.commands["torque"].any()


@pytest.mark.parametrize("state", [AxisState.FAULT, AxisState.SWITCH_ON_DISABLED])
def test_a_drive_that_leaves_operation_enabled_stops_the_robot(state: AxisState) -> None:
    def spoil(image: ProcessImage) -> None:
        image.axes["state"][6] = state

    statue = go_on(Statue().until(State.HOLD), spoil)
    assert statue.at(State.SAFE_STOP)
    assert end(statue, spoil) == (State.FAULT, Fault.DRIVE_FAULT, 6)


def test_a_cell_that_reports_a_defect_stops_the_robot() -> None:
    def spoil(image: ProcessImage) -> None:
        image.cells["status"][4] = 1

    statue = go_on(Statue().until(State.HOLD), spoil)
    assert end(statue, spoil) == (State.FAULT, Fault.CELL_BAD, 4)


def test_contact_beyond_its_limit_stops_softly() -> None:
    def spoil(image: ProcessImage) -> None:
        image.cells["force"][8] = 30.0

    statue = go_on(Statue().until(State.ACTIVE), spoil, 20)
    assert statue.at(State.SAFE_STOP)
    statue.rest(30)
    assert float(statue.record.stiffness.k_eq) == LAW.minimum, "soft even when contact is gone"
    assert end(statue, spoil)[:2] == (State.FAULT, Fault.CONTACT_LIMIT)


def test_an_offset_too_large_to_tare_never_arms() -> None:
    def spoil(image: ProcessImage) -> None:
        image.cells["force"][1] = CONTROL.sequence.tare_limit + 1.0

    assert end(Statue(), spoil, 50) == (State.FAULT, Fault.CELL_BAD, 1)


def test_tare_takes_the_offset_out() -> None:
    statue = Statue()
    offset = np.linspace(-2.0, 2.0, 9)

    def spoil(image: ProcessImage) -> None:
        image.cells["force"] += offset

    go_on(statue, spoil, 20)
    assert statue.at(State.STANDBY)
    np.testing.assert_allclose(statue.record.force_cells.tare, offset, atol=1e-12)
    np.testing.assert_allclose(statue.record.tension.measured, 0.0, atol=1e-12)


def test_a_stated_tare_stands_in_for_a_measured_one() -> None:
    """What a cell reads beyond it stays to be seen: the platform hangs, say."""
    stated, load = np.linspace(-1.0, 1.0, 9), 0.75
    sequence = CONTROL.sequence.model_copy(update={"tare": tuple(stated.tolist())})
    control = CONTROL.model_copy(update={"sequence": sequence})
    statue = Statue(ControlCycle(CONFIG.robot, control, CONFIG.tracker, SCENARIO.reference))

    def spoil(image: ProcessImage) -> None:
        image.cells["force"] += stated + load

    go_on(statue, spoil, 60)
    assert statue.at(State.STANDBY)
    np.testing.assert_allclose(statue.record.force_cells.tare, stated)
    np.testing.assert_allclose(statue.record.tension.measured, load, atol=1e-12)


def test_a_drive_that_does_not_come_up_in_time_is_named() -> None:
    statue = Statue().until(State.REFERENCING)

    def spoil(image: ProcessImage) -> None:
        image.axes["state"][7] = AxisState.SWITCHED_ON

    go_on(statue, spoil, 40)
    assert not statue.image.commands["torque"].any()
    statue.rest(100)
    assert statue.at(State.FAULT)
    assert statue.cycle.sequence.fault is Fault.ENABLE_TIMEOUT
    assert statue.cycle.sequence.where == 7


def blind(image: ProcessImage) -> None:
    image.tracker["fresh"] = 0


def elsewhere(image: ProcessImage) -> None:
    image.tracker["position"] = np.add(REST, (0.0, 0.2, 0.0))


def askew(image: ProcessImage) -> None:
    image.tracker["quaternion"] = (np.cos(0.02), np.sin(0.02), 0.0, 0.0)


def restless(image: ProcessImage) -> None:
    image.tracker["sequence"] += 1
    image.tracker["position"][0] += 0.01 if image.tracker["sequence"] // 8 % 2 else -0.01


def slack(image: ProcessImage) -> None:
    image.cells["force"][3] = 2.0


def loose(image: ProcessImage) -> None:
    image.cells["force"][3] = 9.5


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (blind, "tracker poses"),
        (elsewhere, "from its cradle"),
        (askew, "lies askew, turned by 2.3 deg"),
        (restless, "spread over"),
        (slack, "still slack after 0.02 s"),
        (loose, "a cable's tension is 2.5 N away from 12 N"),
    ],
)
def test_referencing_refuses_what_it_cannot_trust_and_says_why(spoil: Spoil, reason: str) -> None:
    statue = go_on(Statue().until(State.REFERENCING), spoil, 60)
    sequence = statue.cycle.sequence
    assert sequence.fault is Fault.REFERENCING_FAILED
    assert reason in sequence.reason
    statue.rest(200)
    assert statue.at(State.FAULT)
    assert sequence.fault is Fault.REFERENCING_FAILED


def test_a_reset_leads_back_to_standby_and_the_robot_may_be_armed_again() -> None:
    statue = Statue().until(State.HOLD)
    statue.report()
    statue.step(Operator.ESTOP)
    statue.report()
    statue.step(Operator.ARM)
    assert statue.at(State.FAULT), "a fault is not armed away"
    statue.report()
    statue.step(Operator.RESET)
    assert statue.at(State.STANDBY)
    assert (statue.image.commands["command"] == AxisCommand.RESET_FAULT).all()
    statue.until(State.HOLD)
    assert statue.cycle.sequence.fault is Fault.NONE


def test_a_stop_without_a_fault_ends_in_standby_with_the_drives_off() -> None:
    statue = Statue().until(State.HOLD)
    statue.report()
    statue.step(Operator.STOP)
    assert statue.at(State.SAFE_STOP)
    assert end(statue, lambda image: None) == (State.STANDBY, Fault.NONE, -1)


def test_a_stop_during_pretension_does_not_tighten_the_cables_first() -> None:
    statue = Statue().until(State.PRETENSION)
    statue.rest(5)
    before = statue.record.tension.reference.max()
    statue.report()
    statue.step(Operator.STOP)
    highest = 0.0
    for _ in range(50):
        statue.rest(1)
        highest = max(highest, float(statue.record.tension.reference.max()))
    assert highest <= before + 2.0


def test_an_impossible_step_of_one_encoder_does_not_wrench_the_other_cables() -> None:
    """Five turns of the motor in a millisecond are a hundred times what its speed allows."""
    statue = Statue().until(State.HOLD)
    statue.rest(20)

    def spoil(image: ProcessImage) -> None:
        image.axes["angle"][3] += 2.5

    go_on(statue, spoil)
    assert np.abs(statue.image.commands["torque"]).max() < 0.5 * TORQUE_LIMIT


@pytest.mark.parametrize(("table", "name"), [("cells", "force"), ("axes", "angle")])
def test_a_measurement_that_is_not_a_number_stops_the_robot(table: str, name: str) -> None:
    def spoil(image: ProcessImage) -> None:
        getattr(image, table)[name][2] = np.nan

    statue = go_on(Statue().until(State.HOLD), spoil)
    assert statue.image.commands["torque"][2] == 0.0
    go_on(statue, spoil, STALE)
    assert statue.state in (State.SAFE_STOP, State.FAULT)
    odd = (Fault.IMPLAUSIBLE_DRIVE, Fault.IMPLAUSIBLE_CELL)
    assert statue.cycle.sequence.fault in odd
    assert np.isfinite(statue.image.commands["torque"]).all()


def test_ticks_that_the_host_missed_pass_for_the_cables_damping_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    passed = []
    lengths = Referencing.lengths

    def noted(made: Referencing, angle: Array, tension: Array, skipped: int = 0) -> Array:
        passed.append(skipped)
        return lengths(made, angle, tension, skipped)

    monkeypatch.setattr(Referencing, "lengths", noted)
    statue = Statue().until(State.HOLD)
    statue.number += 4
    statue.rest(2)
    assert passed[-3:] == [0, 4, 0]


def judges(monkeypatch: pytest.MonkeyPatch) -> list[type]:
    """Who is asked from now on."""
    called: list[type] = []
    for kind in (DrumObserver, Isolation, Witness):
        monkeypatch.setattr(kind, "step", lambda *_, kind=kind, **__: called.append(kind))
    return called


def moving(image: ProcessImage) -> None:
    image.cells["force"][:8] += np.linspace(-0.3, 0.3, 8)


@pytest.mark.parametrize("state", [State.STANDBY, State.REFERENCING, State.HOLD, State.SAFE_STOP])
def test_torques_wait_for_no_judgement_of_their_tick(state: State) -> None:
    """Two ticks, of which one is whole and one has its outputs read before it is judged."""
    whole, apart = Statue().until(state), Statue().until(state)
    for _ in range(20):
        for statue in (whole, apart):
            statue.report()
            moving(statue.image)
        image, tick = apart.image, apart.number
        apart.cycle.act(image, tick, Operator.NONE)
        sent = image.commands.tobytes()
        apart.cycle.judge(image)
        apart.cycle.write(image, tick, Operator.NONE)
        apart.number += 1
        whole.step()
        assert sent == whole.image.commands.tobytes()
        assert apart.record.data.tobytes() == whole.record.data.tobytes()


def test_a_tick_is_judged_by_what_was_asked_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last torques and references are those that its measurements answer, and the tick has
    written its own over them; the lengths are its own."""
    statue = Statue().until(State.ACTIVE)
    cycle = statue.cycle
    drums, references, lengths = [], [], []
    drum, residual = DrumObserver.step, Isolation.step
    seen = Witness.step

    def drum_step(self: DrumObserver, *given: Any, **named: Any) -> None:
        drums.append((given[3].copy(), given[4].copy(), named))
        drum(self, *given, **named)

    def residual_step(self: Isolation, *given: Any) -> None:
        references.append(given[2].copy())
        residual(self, *given)

    def seen_step(self: Witness, *given: Any) -> None:
        lengths.append(given[1].copy())
        seen(self, *given)

    monkeypatch.setattr(DrumObserver, "step", drum_step)
    monkeypatch.setattr(Isolation, "step", residual_step)
    monkeypatch.setattr(Witness, "step", seen_step)
    for skipped in (0, 0, 3, 0):
        torque = statue.image.torque.copy()
        rate = cycle._drum_rate.copy()
        reference = statue.record.tension.reference.copy()
        statue.number += skipped
        go_on(statue, moving)
        assert (torque != statue.image.torque).any()
        assert (reference != statue.record.tension.reference).any()
        given_torque, given_rate, named = drums.pop()
        np.testing.assert_array_equal(given_torque, torque)
        np.testing.assert_array_equal(given_rate, rate)
        assert named == {"skipped": skipped > 0, "enabled": True}
        np.testing.assert_array_equal(references.pop(), reference)
        np.testing.assert_array_equal(lengths.pop(), cycle._referencing.measured)
        assert not drums + references + lengths, "once a tick"


def test_a_tick_is_judged_once_and_only_after_it_was_computed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    statue = Statue().until(State.HOLD)
    called = judges(monkeypatch)
    statue.cycle.judge(statue.image)
    assert not called
    statue.report()
    statue.cycle.act(statue.image, statue.number, Operator.NONE)
    assert not called
    statue.cycle.judge(statue.image)
    assert len(called) == 3
    statue.cycle.judge(statue.image)
    assert len(called) == 3


@pytest.mark.parametrize(
    ("state", "asked"),
    [
        (State.STANDBY, {DrumObserver}),
        (State.REFERENCING, {DrumObserver}),
        (State.PRETENSION, {DrumObserver, Isolation, Witness}),
    ],
)
def test_without_a_reference_drums_alone_are_judged(
    state: State, asked: set[type], monkeypatch: pytest.MonkeyPatch
) -> None:
    statue = Statue().until(state)
    called = judges(monkeypatch)
    go_on(statue, lambda image: None)
    assert (set(called), len(called)) == (asked, len(asked))


def defect(image: ProcessImage) -> None:
    image.axes["state"][[1, 2, 3, 4]] = AxisState.FAULT


def test_a_passive_stop_is_judged_without_the_estimate_to_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    statue = Statue().until(State.HOLD)
    sequence, called, shares = statue.cycle.sequence, judges(monkeypatch), set()
    while go_on(statue, defect).at(State.SAFE_STOP):
        assert sequence.stop_mode is StopMode.PASSIVE
        assert called == [DrumObserver, Witness]
        called.clear()
        shares.add(sequence.passive_share)
    assert {0.0, 1.0} < shares
    assert called == [DrumObserver]
    assert sequence.referenced


def test_a_passive_stop_without_a_reference_has_no_lengths_to_judge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    statue = Statue().until(State.REFERENCING)
    sequence, called = statue.cycle.sequence, judges(monkeypatch)
    go_on(statue, lambda image: None, 3)
    called.clear()
    go_on(statue, defect)
    assert sequence.passive_share >= 0.0
    assert called == [DrumObserver]


def test_the_solver_is_named_while_it_works_and_not_otherwise() -> None:
    statue = Statue().until(State.STANDBY)
    assert statue.record.tension.solver == Solver.NONE
    statue.until(State.HOLD)
    assert statue.record.tension.solver in (Solver.OPTIMAL, Solver.INTERIOR)


def test_the_pid_controller_keeps_its_stiffness() -> None:
    control = CONTROL.model_copy(update={"controller": "pid"})
    cycle = ControlCycle(CONFIG.robot, control, CONFIG.tracker, SCENARIO.reference)
    statue = Statue(cycle).until(State.HOLD)
    statue.rest(800)
    assert float(statue.record.stiffness.k_eq) == CONTROL.pid.stiffness
    assert statue.at(State.HOLD)


# --- closed on the plant -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hold() -> tuple[ClosedLoop, Trace]:
    """A short run from switch-on to STANDBY, with everything the cycle was given."""
    config, scenario = configured("hold", QUICK)
    loop = ClosedLoop(config, scenario.model_copy(update={"duration": 1.0}))
    loop.keep_inputs = True
    return loop, loop.complete()


def test_a_run_goes_through_its_states_and_ends_at_rest(hold: tuple[ClosedLoop, Trace]) -> None:
    loop, trace = hold
    changes = np.flatnonzero(np.diff(trace.state)) + 1
    order = [State.STANDBY, State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE]
    order += [State.SAFE_STOP, State.STANDBY]
    assert [State(s) for s in trace.state[changes]] == order
    assert loop.cycle.sequence.fault is Fault.NONE
    lowest, last = trace.truth["position"][:, 2].min(), trace.truth["position"][-1]
    assert lowest > REST[2] - 0.005
    np.testing.assert_allclose(last, REST, atol=0.01)


def test_commanded_tensions_keep_their_bounds_and_everything_is_finite(
    hold: tuple[ClosedLoop, Trace],
) -> None:
    _, trace = hold
    for state in (State.HOLD, State.ACTIVE):
        cycle = trace.during(state).cycle
        assert cycle["tension"]["reference"].min() >= TENSION.min
        assert cycle["tension"]["reference"].max() <= TENSION.max
        assert cycle["stiffness"]["k_eq"].min() >= LAW.minimum
        assert cycle["stiffness"]["k_eq"].max() <= LAW.maximum
    assert not_finite(trace.cycle) == []


def test_equal_inputs_make_equal_records_bit_for_bit(hold: tuple[ClosedLoop, Trace]) -> None:
    loop, trace = hold
    config, scenario = configured("hold", QUICK)
    again = ControlCycle(config.robot, config.control, config.tracker, scenario.reference)
    image = ProcessImage(8)
    for tick, given in enumerate(loop.inputs):
        image.axes[:], image.cells[:] = given.axes, given.cells
        image.tracker[...] = given.tracker
        record = again.step(image, tick, given.operator)
        assert record.data.tobytes() == trace.cycle[tick].tobytes(), tick


@pytest.mark.parametrize("cable", [pytest.param(2, marks=pytest.mark.long), 6])
def test_without_a_cable_the_platform_comes_down_on_moderate_tensions(cable: int) -> None:
    config, scenario = configured("hold", QUICK)
    loop = ClosedLoop(config, scenario)
    loop.until(State.ACTIVE)
    loop.silent_axes.add(cable)
    loop.run(FRESH * 1e-3)
    assert loop.image.commands["torque"][cable] != 0.0
    loop.run(2e-3)
    assert loop.image.commands["torque"][cable] == 0.0
    loop.until(State.SAFE_STOP, within=(STALE + 2) * 1e-3)
    loop.until(State.FAULT)
    sequence = loop.cycle.sequence
    assert (sequence.fault, sequence.where) == (Fault.DRIVE_LOST, cable)
    stop = loop.trace.during(State.SAFE_STOP)
    assert np.isfinite(stop.cycle["drives"]["torque_command"]).all()
    assert stop.cycle["tension"]["reference"].max() <= CONTROL.stop.most_tension
    assert stop.truth["tension"].max() < 0.5 * TENSION.max
    # It comes to lie on the table, which may be on an edge.
    assert stop.truth["position"][-1, 2] < REST[2] + 0.06
    assert np.linalg.norm(stop.truth["velocity"], axis=1).max() < 0.3


def test_a_stop_under_the_full_load_holds_until_the_load_is_gone() -> None:
    """31 mm aside at 100 N, the platform would be thrown by its cradle, or by the load alone."""
    config, scenario = configured("hold", QUICK)
    course = ((3.6, 0.0), (4.6, 100.0), (6.0, 100.0), (6.5, 0.0))
    profile = tuple(LoadPoint(at=at, force=force) for at, force in course)
    load = Load(direction=(1.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), profile=profile)
    loop = ClosedLoop(config, scenario.model_copy(update={"lab": LabScript(load=load)}))
    loop.until(State.ACTIVE)
    while loop.plant.load_wrench[0] < 99.9:
        loop.tick()
    loop.tick(Operator.STOP)
    for _ in range(8000):
        loop.tick()
        if loop.state is not State.SAFE_STOP:
            break
    assert loop.state is State.STANDBY
    assert loop.cycle.sequence.fault is Fault.NONE
    stop = loop.trace.during(State.SAFE_STOP)
    loaded = stop.truth["load"][:, 0] > 99.0
    assert loaded.sum() > 1000
    assert np.abs(stop.truth["position"][loaded, 2] - config.robot.home[2]).max() < 1.0e-3
    assert np.linalg.norm(stop.truth["velocity"], axis=1).max() < CONTROL.envelope.speed_limit


def test_a_stop_does_not_wait_for_ever() -> None:
    waits = 0.3
    config, scenario = configured("hold", QUICK | {"control.sequence.hold_s": waits})
    profile = (LoadPoint(at=3.4, force=0.0), LoadPoint(at=3.8, force=30.0))
    load = Load(direction=(1.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), profile=profile)
    loop = ClosedLoop(config, scenario.model_copy(update={"lab": LabScript(load=load)}))
    loop.until(State.ACTIVE)
    while loop.plant.load_wrench[0] < 29.9:
        loop.tick()
    loop.tick(Operator.STOP)
    lasted = 0
    while loop.state is State.SAFE_STOP:
        loop.tick()
        lasted += 1
        assert lasted < 5000
    sequence = config.control.sequence
    planned = 2.0 * sequence.stop_s + sequence.lower_s + waits
    assert lasted >= round(planned / config.control.rates.period)
