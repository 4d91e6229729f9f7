"""The state machine at its bounds: cables that are given up, a length that the witness names, a
descent that rises or is pushed, and devices that raise no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.sequence_setup import REST_TICKS, STOP_TICKS, Way, descent
from tonus.drivers.process_image import AxisState
from tonus.runtime.control.sensing import NOT_ENABLED
from tonus.runtime.states import Fault, State, StopMode


def test_a_given_up_cable_is_not_sound_whatever_it_measures() -> None:
    way = Way().to(State.ACTIVE)
    way.sensing.sound[3] = False
    assert np.flatnonzero(~way.sequence.sound).tolist() == [3]
    way.fail(5)
    assert np.flatnonzero(way.sequence.faults.failed).tolist() == [5]
    assert np.flatnonzero(~way.sequence.sound).tolist() == [3, 5]


@pytest.mark.parametrize("cable", [0, 5])
def test_a_length_that_the_witness_names_stops_and_excludes_no_cable(cable: int) -> None:
    way = Way().to(State.HOLD)
    way.witness.misread = cable
    way.step()
    assert way.state is State.SAFE_STOP
    assert (way.sequence.fault, way.sequence.where) == (Fault.LENGTH_DRIFT, cable)
    assert not way.sequence.faults.failed.any()


def test_a_platform_that_rises_on_its_path_is_no_descent_that_hangs() -> None:
    way = Way().stop()
    way.sequence.height = 0.05
    way.steps(REST_TICKS + 2)
    way.sequence.height = 0.2
    way.steps(2)
    assert way.sequence.stop_mode is StopMode.ON_PATH


def test_a_platform_that_has_landed_does_not_hang_when_it_moves_up() -> None:
    """On the bound of the cradle itself, and once its tensions are let go."""
    way = descent()
    way.sequence.height = -0.02
    way.steps(REST_TICKS + 2)
    way.sequence.height = 0.01
    way.steps(2)
    assert way.sequence.stop_mode is StopMode.DESCENT
    way.sequence.height = 0.0
    way.steps(STOP_TICKS)
    assert way.sequence.releasing
    way.sequence.height = 0.05
    way.steps(1)
    assert way.sequence.stop_mode is StopMode.DESCENT


@pytest.mark.parametrize("load", [0.0, 10.1, 500.0])
def test_no_load_that_it_measures_holds_a_platform_that_has_landed(load: float) -> None:
    way = descent()
    way.sequence.height, way.sequence.load = 0.0, load
    way.steps(STOP_TICKS + 1)
    assert way.sequence.releasing


def test_without_an_alarm_no_device_is_asked() -> None:
    """And a drive that is not enabled is none while none has to be."""
    for state, alarm in ((State.HOLD, 0), (State.STANDBY, NOT_ENABLED)):
        way = Way().to(state)
        way.sensing.alarm, way.lost_axes = alarm, {2}
        way.steps(3)
        assert way.sequence.fault is Fault.NONE


def test_a_drive_that_alone_leaves_operation_enabled_is_found() -> None:
    way = Way().to(State.HOLD)
    way.sensing.alarm, way.obeying = NOT_ENABLED, False
    way.image.axes["state"][3] = AxisState.SWITCH_ON_DISABLED
    way.step()
    assert (way.sequence.fault, way.sequence.where) == (Fault.DRIVE_FAULT, 3)
