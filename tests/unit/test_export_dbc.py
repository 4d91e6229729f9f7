"""The DBC of a configuration, as cantools reads it."""

from __future__ import annotations

from typing import Any

import cantools.database
import pytest
from cantools.database.can import Database

from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.tools.errors import ToolError
from tonus.tools.export import dbc, messages


def exported(
    name: str = "config/can.yaml",
    overrides: dict[str, Any] | None = None,
    channel: int | None = None,
) -> Database:
    config = load(name, overrides=overrides)[0]
    bus = config.fieldbus
    assert isinstance(bus, CanopenBus)
    channels = bus.channels if channel is None else (bus.channels[channel],)
    text = dbc.write(
        messages.nodes(config, bus, channels), messages.messages(config, bus, channels)
    )
    found = cantools.database.load_string(text, "dbc")
    assert isinstance(found, Database)
    return found


@pytest.fixture(scope="module")
def can4() -> Database:
    return exported()


def test_every_frame_of_the_predefined_connection_set_is_there(can4: Database) -> None:
    nodes = [*range(1, 9), *range(17, 26)]
    expected = {0x000, 0x080, 0x77F}
    for base in (0x080, 0x180, 0x580, 0x600, 0x700):
        expected |= {base + node for node in nodes}
    expected |= {0x200 + node for node in range(1, 9)}
    assert {message.frame_id for message in can4.messages} == expected
    assert len(can4.messages) == len(expected)


def test_who_sends_what_how_often(can4: Database) -> None:
    assert can4.get_message_by_frame_id(0x183).senders == ["Axis2"]
    assert can4.get_message_by_frame_id(0x183).cycle_time == 1
    assert can4.get_message_by_frame_id(0x199).senders == ["Contact"]
    assert can4.get_message_by_frame_id(0x205).senders == ["Master"]
    assert can4.get_message_by_frame_id(0x205).signals[0].receivers == ["Axis4"]
    assert can4.get_message_by_frame_id(0x77F).cycle_time == 20
    assert can4.get_message_by_frame_id(0x701).cycle_time == 100


def test_numbers_are_in_si_units_at_the_drum(can4: Database) -> None:
    # A quarter turn of the drum behind a 49:4 gear, 4096 increments a turn of the motor; half the
    # rated torque of 8 A at 0.071 N m/A.
    data = bytes.fromhex("37 02") + (12544).to_bytes(4, "little") + (-500).to_bytes(
        2, "little", signed=True
    )  # fmt: skip
    told = can4.decode_message(0x181, data)
    assert told["Statusword_State"] == "OPERATION_ENABLED"
    assert told["Statusword_Remote"] == 1
    assert told["Statusword_InternalLimit"] == 0
    assert told["Position"] == pytest.approx(3.141592653589793 / 2)
    assert told["Torque"] == pytest.approx(-0.5 * 8 * 0.071 * 49 / 4)
    assert can4.decode_message(0x191, (-1234).to_bytes(4, "little", signed=True)) == {
        "Force": pytest.approx(-12.34)
    }


def test_an_axis_of_its_own_has_numbers_of_its_own() -> None:
    """A motor with other encoder and gear that turns down to reel in."""
    own = {
        "sign": -1,
        "gearbox": {"numerator": 10, "denominator": 1},
        "motor": {"encoder_pulses": 500, "torque_constant": 0.1, "nominal_current": 5.0},
    }
    found = exported(overrides={"robot.axes": {2: own}})
    data = bytes.fromhex("37 02") + (5000).to_bytes(4, "little") + (100).to_bytes(2, "little")
    told = found.decode_message(0x183, data)
    assert told["Position"] == pytest.approx(-3.141592653589793 / 2)
    assert told["Torque"] == pytest.approx(-0.1 * 5 * 0.1 * 10)
    assert found.decode_message(0x181, data)["Position"] > 0.0


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0240, "SWITCH_ON_DISABLED"),
        (0x0270, "SWITCH_ON_DISABLED"),
        (0x0250, "SWITCH_ON_DISABLED"),
        (0x0231, "READY_TO_SWITCH_ON"),
        (0x0233, "SWITCHED_ON"),
        (0x1237, "OPERATION_ENABLED"),
        (0x0217, "QUICK_STOP_ACTIVE"),
        (0x021F, "FAULT_REACTION_ACTIVE"),
        (0x0218, "FAULT"),
        (0x0238, "FAULT"),
        (0x0000, "NOT_READY"),
    ],
)
def test_the_statuswords_state_is_named_whatever_its_other_bits(
    word: int, state: str, can4: Database
) -> None:
    told = can4.decode_message(0x181, word.to_bytes(2, "little") + bytes(6))
    assert told["Statusword_State"] == state
    rest = sum(
        told[signal.name] << signal.start
        for signal in can4.get_message_by_frame_id(0x181).signals
        if signal.name.startswith("Statusword_") and signal.start >= 7
    )
    assert rest == word & 0xFF80


def test_commands_and_emergencies_are_named(can4: Database) -> None:
    assert can4.decode_message(0x000, b"\x81\x03") == {"Command": "RESET_NODE", "Node": 3}
    assert can4.decode_message(0x201, b"\x0f\0\0\0")["Controlword"] == "ENABLE_OPERATION"
    assert can4.decode_message(0x701, b"\x05") == {"State": "OPERATIONAL"}
    told = can4.decode_message(0x081, b"\x30\x81\x10" + bytes(5))
    assert told["ErrorCode"] == "heartbeat of the master lost"


@pytest.mark.parametrize(
    ("entry", "data", "force"),
    [
        (0x61300120, bytes.fromhex("0000c03f"), 1.5),
        (0x71300110, b"\xff\xff", -0.001),
        (0x91300120, b"\xff\xff\xff\xff", -0.001),
    ],
)
def test_a_cell_is_read_in_each_of_its_forms(entry: int, data: bytes, force: float) -> None:
    over = {"fieldbus.force_cell.tpdo": [entry], "fieldbus.force_cell.decimal_digits": 3}
    told = exported(overrides=over).decode_message(0x191, data)
    assert told == {"Force": pytest.approx(force)}


def test_an_amplifier_of_several_cells_names_them() -> None:
    cells = [{"cells": [1, 7, 8], "node_id": 24}]
    told = exported(overrides={"fieldbus.channels.3.force_cells": cells}).decode_message(
        0x198, b"\x01\0\xff\xff\x64\0"
    )
    assert told == {
        "Force_Cell1": pytest.approx(0.01),
        "Force_Cell7": pytest.approx(-0.01),
        "Force_Contact": pytest.approx(1.0),
    }


def test_an_object_without_a_name_is_given_raw() -> None:
    found = exported(overrides={"fieldbus.drive.tpdo": [0x60410010, 0x606C0020, 0x31600110]})
    told = found.decode_message(0x181, b"\0\0" + b"\xff" * 6)
    assert (told["Object_606C_00"], told["Object_3160_01"]) == (-1, 0xFFFF)


def test_one_channel_alone_has_only_its_own(can4: Database) -> None:
    alone = exported(channel=3)
    assert [node.name for node in alone.nodes] == [
        "Master",
        "Axis1",
        "Axis7",
        "Cell1",
        "Cell7",
        "Contact",
    ]
    for message in alone.messages:
        if message.frame_id not in (0x000, 0x080, 0x77F):
            assert can4.get_message_by_frame_id(message.frame_id).name == message.name


def test_equal_identifiers_on_two_channels_do_not_go_into_one_file() -> None:
    over = {"fieldbus.channels.1.drives": [{"axis": 2, "node_id": 1}, {"axis": 4, "node_id": 5}]}
    with pytest.raises(
        ToolError, match=r"0x081 is Axis0_EMCY on can0 and Axis2_EMCY on can1;.*--channel"
    ):
        exported(overrides=over)
    assert exported(overrides=over, channel=1).get_message_by_frame_id(0x181).name == "Axis2_TPDO1"


def test_a_mapping_that_no_frame_can_carry_is_named() -> None:
    with pytest.raises(ToolError, match=r"fieldbus.drive.tpdo: 0x6041:0 has 12 bits"):
        exported(overrides={"fieldbus.drive.tpdo": [0x6041000C]})
