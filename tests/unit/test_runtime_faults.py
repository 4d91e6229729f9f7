"""The faults with their places, and which cables, drums and cells they leave."""

from __future__ import annotations

import pytest

from tonus.config import load
from tonus.runtime.safety.faults import CABLE_GONE, PASSIVE, Faults
from tonus.runtime.states import Fault

ROBOT = load("config/can.yaml")[0].robot
N = ROBOT.cables
CONTACT_CELL = N

OF_THE_CELL = {Fault.CELL_LOST, Fault.CELL_BAD, Fault.IMPLAUSIBLE_CELL, Fault.CELL_FROZEN}
OF_THE_ENCODER = {Fault.DRIVE_LOST, Fault.IMPLAUSIBLE_DRIVE, Fault.DRUM_STUCK}
HOLDING = OF_THE_ENCODER | {Fault.DRIVE_FAULT}
BY_CONTRADICTION = {
    Fault.SLACK_CABLE,
    Fault.LENGTH_JUMP,
    Fault.TENSION_ERROR,
    Fault.LENGTH_DRIFT,
    Fault.CELL_FROZEN,
    Fault.DRUM_TORQUE,
    Fault.DRUM_STUCK,
}


@pytest.fixture
def faults() -> Faults:
    return Faults(ROBOT)


def test_the_first_fault_is_the_reason(faults: Faults) -> None:
    assert (faults.first, faults.where, faults.count) == (Fault.NONE, -1, 0)
    assert not faults.add(Fault.NONE, -1), "no fault"
    assert faults.count == 0
    assert faults.add(Fault.CABLE_TORN, 3)
    assert not faults.add(Fault.CABLE_TORN, 3), "found before"
    assert faults.add(Fault.CABLE_TORN, 4)
    assert faults.add(Fault.CONTACT_LIMIT, -1)
    assert (faults.first, faults.where, faults.count) == (Fault.CABLE_TORN, 3, 3)
    assert [faults.at(Fault.CABLE_TORN, cable) for cable in range(2, 6)] == [
        False,
        True,
        True,
        False,
    ]
    assert faults.at(Fault.CONTACT_LIMIT, -1)
    assert faults.has(Fault.CABLE_TORN)
    assert not faults.has(Fault.DRIVE_LOST)


def test_a_reset_takes_everything_back(faults: Faults) -> None:
    for fault in Fault:
        faults.add(fault, 2)
    faults.freed[2] = True
    faults.reset()
    assert not faults.freed.any()
    assert (faults.first, faults.where, faults.count) == (Fault.NONE, -1, 0)
    assert not faults.found.any()
    assert not faults.failed.any()
    assert not faults.contradicted
    assert faults.add(Fault.CABLE_TORN, 2)


@pytest.mark.parametrize("fault", [each for each in Fault if each is not Fault.NONE])
def test_what_each_fault_leaves(fault: Fault) -> None:
    """At a cable: whether it pulls on, whether encoder and cell are believed, whether its drum
    turns freely and may reel in; the other cables are as they were."""
    found = Faults(ROBOT)
    found.add(fault, 5)
    gone = fault in CABLE_GONE
    assert found.failed.tolist() == [gone and cable == 5 for cable in range(N)]
    for rows, causes in (
        (found.drums_trusted, OF_THE_ENCODER),
        (found.cells_trusted, OF_THE_CELL),
        (found.drums_obedient, {Fault.DRUM_TORQUE}),
        (~found.torn, {Fault.CABLE_TORN}),
    ):
        assert rows.tolist() == [fault not in causes or cable != 5 for cable in range(N)]
    free = gone and fault not in HOLDING
    unlike = fault in OF_THE_CELL | OF_THE_ENCODER | {Fault.DRUM_TORQUE, Fault.CABLE_TORN}
    damps = free and not unlike
    assert found.damping.tolist() == [damps and cable == 5 for cable in range(N)]
    assert found.let_go.tolist() == [free and not damps and cable == 5 for cable in range(N)]
    held = gone and fault in HOLDING - OF_THE_ENCODER
    assert found.held.tolist() == [held and cable == 5 for cable in range(N)]
    assert found.contradicted is (fault in BY_CONTRADICTION)
    assert {*OF_THE_CELL, *HOLDING, *BY_CONTRADICTION, Fault.CABLE_TORN} == CABLE_GONE
    assert frozenset({Fault.NOT_FINITE}) == PASSIVE


@pytest.mark.parametrize("cable", [0, N - 1])
def test_the_first_and_the_last_cable(faults: Faults, cable: int) -> None:
    faults.add(Fault.DRUM_TORQUE, cable)
    assert faults.failed.tolist() == [each == cable for each in range(N)]
    assert faults.let_go.tolist() == faults.failed.tolist()
    assert faults.contradicted
    faults.add(Fault.CELL_FROZEN, cable)
    assert faults.cells_trusted.tolist() == [each != cable for each in range(N)]


def test_a_drum_that_turns_again_damps(faults: Faults) -> None:
    """It had jammed; one that is reversed does not stand. Its cable stays given up."""
    faults.add(Fault.DRUM_TORQUE, 3)
    faults.add(Fault.DRUM_TORQUE, 4)
    faults.freed[3] = True
    assert faults.drums_obedient.tolist() == [cable != 4 for cable in range(N)]
    assert faults.damping.tolist() == [cable == 3 for cable in range(N)]
    assert faults.let_go.tolist() == [cable == 4 for cable in range(N)]
    assert faults.failed.tolist() == [cable in (3, 4) for cable in range(N)]


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.NONE])
def test_only_what_is_wrong_with_its_encoder_hides_a_drum_that_answers(
    faults: Faults, fault: Fault
) -> None:
    """A drive that was lost and answers again is heard; its cable stays given up."""
    faults.add(fault, 3)
    hidden = fault in OF_THE_ENCODER - {Fault.DRIVE_LOST}
    assert faults.drums_readable.tolist() == [not (hidden and cable == 3) for cable in range(N)]
    if fault is Fault.DRIVE_LOST:
        assert faults.failed[3]
        assert not faults.drums_trusted[3]


def test_a_cell_that_is_not_believed_holds_nothing(faults: Faults) -> None:
    faults.add(Fault.DRIVE_FAULT, 3)
    faults.add(Fault.CELL_FROZEN, 3)
    assert not faults.held.any()


def test_a_fault_of_no_cable_excludes_none(faults: Faults) -> None:
    """Nowhere, and at the contact cell, whose place comes after the last cable's."""
    faults.add(Fault.CELL_BAD, CONTACT_CELL)
    faults.add(Fault.DRIVE_LOST, -1)
    assert not faults.failed.any()
    assert faults.cells_trusted.all()
    assert faults.drums_trusted.all()
    assert faults.at(Fault.CELL_BAD, CONTACT_CELL)


def test_a_cable_that_pulls_on_is_not_contradicted(faults: Faults) -> None:
    faults.add(Fault.LENGTH_DRIFT, 1, exclude=False)
    assert not faults.failed.any()
    assert not faults.contradicted
    faults.add(Fault.CABLE_TORN, 1)
    assert not faults.contradicted, "it is excluded because it is torn, which needs no conclusion"
