"""The master's table of drive errors, against the one the emulated drive was written from."""

from __future__ import annotations

from tonus.config import load
from tonus.drivers.devices.drive_errors import Errors, Reaction, Reset
from tonus.sim.devices.epos4 import errors as emulated

DRIVE = Errors(load("config/can.yaml")[0].fieldbus.drive)
ERRORS = DRIVE.listed
LETTER = {
    Reaction.POWER_OFF: "D",
    Reaction.ABORT: "A",
    Reaction.FAULT: "F",
    Reaction.WARNING: "W",
}
ONLY_WARNS = 0x8A8A
"""Class D in the maker's list, whose text calls it a warning: in words it is one."""


def test_every_error_of_the_emulated_drive_is_known_with_its_reaction() -> None:
    for code, error in emulated.ERRORS.items():
        assert code in ERRORS, f"0x{code:04X}"
        reaction = ERRORS[code].reaction
        if code != ONLY_WARNS:
            assert reaction is not None
            assert LETTER[reaction] == error.reaction, f"0x{code:04X}"


def test_two_errors_need_a_communication_reset() -> None:
    needing = {code for code in ERRORS if DRIVE.reset(code) is Reset.COMMUNICATION_RESET}
    assert needing == {0x8120, 0x8130}


def test_an_error_is_reported_with_reaction_reset_and_what_it_costs() -> None:
    assert DRIVE.text(0x7380) == (
        "position sensor breach; power off at once, a fault reset clears it, the position is lost"
    )
    assert "cleared with the error history" in DRIVE.text(0xFF01)
    assert DRIVE.text(0) == Errors().text(0) == "no error left"


def test_other_devices_and_other_codes_are_told_by_their_class() -> None:
    assert Errors().text(0x8130) == "communication error"
    assert DRIVE.text(0x8199) == "communication error"
    assert DRIVE.text(0x0123) == "unknown error"
    assert DRIVE.reset(0x1234) is Reset.FAULT_RESET
