"""After the supervisor has stopped every drive, the operator's reset brings all of them back, and
they can be enabled again."""

from __future__ import annotations

import pytest

from tests.supervised import BRIEF
from tonus.drivers.process_image import AxisState
from tonus.tools.testing.held import HeldFactory

pytestmark = pytest.mark.wide

SUPERVISOR = 0x77E
"""identifier of its heartbeat"""


@pytest.mark.tonus(overrides=BRIEF)
@pytest.mark.tonus_expect("*")
def test_a_reset_brings_every_drive_back_and_they_can_be_enabled(
    tonus_held: HeldFactory,
) -> None:
    held = tonus_held()
    for number in range(4):
        held.fault("loss", channel=f"can{number}", identifier=SUPERVISOR, duration=0.5)
    held.advance(6000)
    assert held.state == "FAULT"
    told = {each.where for each in held.events if each.name == "emcy" and "0x8130" in each.text}
    assert len(told) == 8, "every drive lost the supervisor's heartbeat"
    held.command("reset")
    held.advance(3000)
    assert held.state == "STANDBY"
    held.command("arm")
    held.advance(500)
    assert held.state == "REFERENCING"
    assert (held.record["drives"]["state"] == AxisState.OPERATION_ENABLED).all()
    assert not [each for each in held.events if each.name == "supervisor_lost" and each.time > 6.0]
    held.end()
