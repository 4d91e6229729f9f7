"""The master's table of drive errors, against the one the emulated drive was written from."""

from __future__ import annotations

from tonus.drivers.canopen import emcy
from tonus.drivers.devices.epos4_errors import ERRORS, Cure, Reaction, cure
from tonus.sim.devices.epos4 import errors as emulated

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
        if code != ONLY_WARNS:
            assert LETTER[ERRORS[code].reaction] == error.reaction, f"0x{code:04X}"


def test_two_errors_need_a_communication_reset() -> None:
    needing = {code for code in ERRORS if cure(code) is Cure.COMMUNICATION_RESET}
    assert needing == {0x8120, 0x8130}


def test_an_error_is_told_with_reaction_cure_and_what_it_costs() -> None:
    assert emcy.words(0x7380, drive=True) == (
        "position sensor breach; power off at once, a fault reset clears it, the position is lost"
    )
    assert "cleared with the error history" in emcy.words(0xFF01, drive=True)
    assert emcy.words(0, drive=True) == emcy.words(0, drive=False) == "no error left"


def test_other_devices_and_other_codes_are_told_by_their_class() -> None:
    assert emcy.words(0x8130, drive=False) == "communication error"
    assert emcy.words(0x8199, drive=True) == "communication error"
    assert emcy.words(0x0123, drive=True) == "unknown error"
    assert cure(0x1234) is Cure.FAULT_RESET
