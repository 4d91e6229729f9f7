"""After the relay of the STO inputs has taken every drive's torque, none is enabled by itself; the
operator's reset brings all of them back, and they can be enabled again."""

from __future__ import annotations

import pytest

from tests.supervised import BRIEF
from tonus.drivers.process_image import AxisState
from tonus.tools.testing.held import HeldFactory

pytestmark = pytest.mark.wide

SUPERVISOR = 0x77E
"""identifier of its heartbeat"""


@pytest.mark.tonus(config="config/ethercat.yaml", overrides=BRIEF)
@pytest.mark.tonus_expect("*")
def test_a_reset_brings_every_drive_back_after_the_relay_has_opened(
    tonus_held: HeldFactory,
) -> None:
    held = tonus_held()
    held.fault("loss", channel="sto", identifier=SUPERVISOR, duration=0.5)
    held.advance(3000)
    assert held.state == "FAULT"
    told = {each.where for each in held.events if each.name == "drive_error"}
    assert len(told) == 8, "every drive reports STO"
    assert all("0x8A88" in each.text for each in held.events if each.name == "drive_error")
    assert "sto_relay_open" in {each.name for each in held.events}
    powered = (AxisState.OPERATION_ENABLED, AxisState.QUICK_STOP_ACTIVE)
    assert not [state for state in held.record["drives"]["state"] if state in powered]
    held.command("reset")
    held.advance(3000)
    assert held.state == "STANDBY"
    held.command("arm")
    held.advance(500)
    assert held.state == "REFERENCING"
    assert (held.record["drives"]["state"] == AxisState.OPERATION_ENABLED).all()
    held.end()
