"""The supervisor where drives are on EtherCAT and load cells on CAN: it judges by the record, and
hears what others tell the amplifiers. SUP-27."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import can
import pytest

from tests.unit.recorded_setup import (
    BEAT,
    HELD,
    NODE,
    RELEASED,
    ROBOT,
    Change,
    FakeBus,
    Held,
    disarmed,
)
from tonus.config import Config, load
from tonus.runtime.states import Operator, State


class Beside(Held):
    """A supervisor of drives on EtherCAT with load cells on CAN; a bus for each channel."""

    def __init__(self, config: Config) -> None:
        self.buses: dict[str, FakeBus] = {}
        super().__init__(config)

    def opened(self, channel: str) -> FakeBus:
        bus = self.bus if channel == "sto" else FakeBus()
        return self.buses.setdefault(channel, bus)


@pytest.fixture
def beside() -> Iterator[Beside]:
    relay = load("config/ethercat.yaml")[0].sto_relay
    assert relay is not None
    own = {key: value for key, value in ROBOT.items() if not key.startswith("sto_relay")}
    stated = relay.model_dump(mode="json") | {"timeout_ms": 7}
    made = Beside(load("config/mixed.yaml", overrides=own | {"sto_relay": stated})[0])
    yield made
    made.supervisor.close()


@pytest.mark.parametrize(
    ("identifier", "data", "found"),
    [
        (0x600 + 25, "2323610100001643", True),  # the contact cell's scale
        (0x600 + 21, "2323610100001643", False),  # on the other channel
        (0x600 + 25, "4023610100000000", False),  # read
        (0x000, "8119", True),  # NMT reset node
        (0x000, "8100", True),
        (0x000, "8115", False),
    ],
)
@pytest.mark.parametrize("armed", [False, True])
def test_what_others_tell_an_amplifier_on_can(
    beside: Beside, armed: bool, identifier: int, data: str, found: bool
) -> None:
    """Nothing is sent on its channel, and nothing there is waited for."""
    change: Change = (lambda _: None) if armed else disarmed
    beside.armed() if armed else list(beside.steps(160, disarmed))
    assert beside.step(change) == [BEAT, HELD]
    beside.buses["can0"].waiting.append(
        can.Message(arbitration_id=identifier, data=bytes.fromhex(data), is_extended_id=False)
    )
    sent = [each for _ in range(3) for each in beside.step(change)]
    assert (RELEASED in sent) is found
    assert beside.supervisor.beating is not found
    assert beside.buses.keys() == {"sto", "can0", "can1"}
    assert not beside.buses["can0"].sent
    assert not beside.buses["can1"].sent


@pytest.mark.parametrize("silent", [("can0", 17), ("can1", 22), ("sto", NODE)])
def test_amplifiers_on_can_have_to_be_brought_up_too(
    beside: Beside, silent: tuple[str, int]
) -> None:
    """After another has written to one: each has to boot, the relay's node besides."""

    def failed(record: Any) -> None:
        disarmed(record)
        record["state"]["state"] = State.FAULT
        record["state"]["operator"] = Operator.RESET if record["timing"]["tick"] % 2 else 0

    def boot(channel: str, node: int) -> None:
        beat = can.Message(arbitration_id=0x700 + node, data=b"\0", is_extended_id=False)
        beside.buses[channel].waiting.append(beat)

    list(beside.steps(160, disarmed))
    beside.buses["can0"].waiting.append(
        can.Message(
            arbitration_id=0x600 + 25, data=bytes.fromhex("2323610100001643"), is_extended_id=False
        )
    )
    list(beside.steps(3, disarmed))
    assert not beside.supervisor.beating
    nodes = {("can1" if 4 <= cell < 8 else "can0", 17 + cell) for cell in range(9)}
    for each in {*nodes, ("sto", NODE)} - {silent}:
        boot(*each)
    list(beside.steps(400, failed))
    assert not beside.supervisor.beating
    boot(*silent)
    list(beside.steps(3, disarmed))
    assert beside.supervisor.beating
