"""The state machine's table, the words for its faults, and the script that drives it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tonus.config import load
from tonus.config.schema.scenario import Command
from tonus.runtime.operation.operator import Script
from tonus.runtime.states import ARMED, TRANSITIONS, Event, Fault, Operator, State
from tonus.runtime.words import describe, place, reaction

CONFIG, _ = load("config/can.yaml")
DIRECT, _ = load("config/direct.yaml")


def test_every_pair_of_state_and_event_is_defined() -> None:
    assert set(TRANSITIONS) == {(state, event) for state in State for event in Event}


@pytest.mark.parametrize("state", State)
def test_an_emergency_stop_ends_in_fault_from_everywhere(state: State) -> None:
    assert TRANSITIONS[state, Event.ESTOP] is State.FAULT


def test_only_arming_from_standby_enables_drives() -> None:
    ways = {
        (state, event)
        for (state, event), after in TRANSITIONS.items()
        if state not in ARMED and after in ARMED
    }
    assert ways == {(State.STANDBY, Event.ARM)}
    assert TRANSITIONS[State.STANDBY, Event.ARM] is State.REFERENCING


@pytest.mark.parametrize("state", [State.PRETENSION, State.HOLD, State.ACTIVE])
def test_nothing_moves_that_was_not_referenced(state: State) -> None:
    order = [State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE]
    before = {s for (s, _), after in TRANSITIONS.items() if after is state and s is not state}
    assert State.STANDBY not in before
    assert before <= set(order)
    assert order[order.index(state) - 1] in before


@pytest.mark.parametrize("state", sorted(ARMED - {State.SAFE_STOP}))
def test_a_fault_or_a_stop_leads_an_armed_robot_through_the_controlled_stop(state: State) -> None:
    assert TRANSITIONS[state, Event.FAULT] is State.SAFE_STOP
    assert TRANSITIONS[state, Event.STOP] is State.SAFE_STOP


def test_the_controlled_stop_is_left_only_towards_rest() -> None:
    exits = {TRANSITIONS[State.SAFE_STOP, event] for event in Event} - {State.SAFE_STOP}
    assert exits == {State.STANDBY, State.FAULT}
    assert TRANSITIONS[State.SAFE_STOP, Event.STOPPED_BY_FAULT] is State.FAULT
    assert TRANSITIONS[State.SAFE_STOP, Event.START] is State.SAFE_STOP


def test_a_fault_is_left_only_by_a_reset() -> None:
    assert {event for event in Event if TRANSITIONS[State.FAULT, event] is not State.FAULT} == {
        Event.RESET
    }


def test_operator_commands_are_events_of_the_same_name() -> None:
    for command in Operator:
        if command is not Operator.NONE:
            assert Event(command).name == command.name


@pytest.mark.parametrize("config", [CONFIG, DIRECT], ids=["can", "direct"])
@pytest.mark.parametrize("fault", Fault)
def test_every_fault_has_words(config: Any, fault: Fault) -> None:
    text = describe(config, fault, 3, "because")
    assert text.endswith("(because)")
    assert text.count("\n") == 0
    assert reaction(fault, armed=True)


def test_a_fault_names_its_node() -> None:
    assert place(CONFIG, Fault.DRIVE_LOST, 2) == "can1/3 (axis 2)"
    assert place(CONFIG, Fault.CELL_LOST, 8).endswith("(contact cell)")
    assert place(CONFIG, Fault.CONTACT_LIMIT, -1) == ""


def at(state: State, elapsed: float = 0.0) -> Any:
    return SimpleNamespace(state=state, elapsed=elapsed)


def test_the_script_goes_through_a_run_and_ends_in_standby() -> None:
    script = Script(2.0)
    told = [
        script.next(at(State.OFF)),
        script.next(at(State.STANDBY)),
        script.next(at(State.REFERENCING)),
        script.next(at(State.PRETENSION)),
        script.next(at(State.HOLD, 0.001)),
        script.next(at(State.ACTIVE, 1.999)),
        script.next(at(State.ACTIVE, 2.0)),
        script.next(at(State.SAFE_STOP)),
    ]
    none = Operator.NONE
    assert told == [none, Operator.ARM, none, none, Operator.START, none, Operator.STOP, none]
    assert not script.finished
    assert script.next(at(State.STANDBY)) is none
    assert script.finished


def test_a_fault_finishes_the_script() -> None:
    script = Script(2.0)
    script.next(at(State.STANDBY))
    script.next(at(State.FAULT))
    assert script.finished


def test_asked_once_it_stops_and_asked_twice_it_stops_at_once() -> None:
    script = Script(2.0)
    script.stop()
    assert script.next(at(State.ACTIVE)) is Operator.STOP
    assert script.next(at(State.SAFE_STOP)) is Operator.NONE
    script.stop()
    assert script.next(at(State.SAFE_STOP)) is Operator.ESTOP


def test_asked_to_stop_before_arming_it_never_arms() -> None:
    script = Script(2.0)
    script.stop()
    assert script.next(at(State.STANDBY)) is Operator.NONE
    assert script.finished


def test_commands_of_a_scenario_come_before_the_scripts_own() -> None:
    commands = [Command(at=0.002, command="start"), Command(at=0.004, command="hold")]
    script = Script(2.0, commands=commands, period=1e-3)
    none = Operator.NONE
    assert script.next(at(State.STANDBY)) is Operator.ARM
    told = [script.next(at(State.HOLD, 1.0)) for _ in range(5)]
    assert told == [none, Operator.START, none, Operator.HOLD, Operator.START]


def test_commands_may_be_given_anew_under_way() -> None:
    script = Script(2.0, commands=[Command(at=1.0, command="start")], period=1e-3)
    script.next(at(State.STANDBY))
    script.next(at(State.REFERENCING))
    script.next(at(State.REFERENCING))
    passed = Command(at=0.002, command="estop")
    script.follow([passed, Command(at=0.003, command="stop")])
    assert script.next(at(State.REFERENCING)) is Operator.STOP
