"""A drive as data: what its profile refuses, what it writes, and what its numbers mean."""

from __future__ import annotations

import asyncio
from math import pi
from pathlib import Path
from typing import Any

import pytest

import tonus
from tonus.config import ConfigError, load
from tonus.config.schema.axis import Brake, DriveTrain
from tonus.config.schema.bus import CanopenBus, EthercatBus
from tonus.config.schema.drive import (
    UNIT_OF,
    DriveError,
    DriveOptions,
    DriveProfile,
    DriveSetting,
    EthercatPart,
    Scaling,
)
from tonus.drivers.devices.drive import Scale, read_scale, settings
from tonus.drivers.errors import DriverError, SdoAbortError
from tonus.tools.check.rules import check

CAN, HOLD = load("config/mixed_drives.yaml", "hold")
ETHERCAT, _ = load("config/mixed_drives_ethercat.yaml")
TRAIN = CAN.robot.drive_trains[0]
DRIVE = "fieldbus.drive"


class Objects:
    """An object dictionary of 32-bit values."""

    def __init__(self, held: dict[tuple[int, int], int]) -> None:
        self.held = held

    async def read(self, index: int, subindex: int) -> bytes:
        if (index, subindex) not in self.held:
            raise SdoAbortError(0x06020000, "object does not exist")
        return self.held[index, subindex].to_bytes(4, "little")

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        raise AssertionError("a scale is only read")


def profile(**changed: Any) -> DriveProfile:
    given = {f"{DRIVE}.{key}": value for key, value in changed.items()}
    bus = load("config/mixed_drives.yaml", overrides=given)[0].fieldbus
    assert isinstance(bus, CanopenBus)
    return bus.drive


def scale(held: dict[tuple[int, int], int], sign: int = 1, **scaling: str) -> Scale:
    changed = profile(scaling={"torque": "motor", "position": "motor"} | scaling)
    return asyncio.run(read_scale(Objects(held), changed, TRAIN, sign))


def test_each_axis_has_the_profile_it_names_and_the_others_the_default() -> None:
    for config in (CAN, ETHERCAT):
        assert [config.fieldbus.profile(axis).name for axis in range(8)] == [
            *["EPOS4"] * 2,
            *["CiA 402 drive"] * 6,
        ]
    assert isinstance(ETHERCAT.fieldbus, EthercatBus)
    assert 0x603F0010 in ETHERCAT.fieldbus.profile(2).tpdo
    assert 0x603F0010 not in CAN.fieldbus.profile(2).tpdo
    assert ETHERCAT.fieldbus.profile(2).identity is None
    several = load("config/mixed.yaml")[0].fieldbus
    assert several.profile(7).name == "EPOS4"


def test_an_epos4_is_told_the_same_objects_as_ever_in_the_same_order() -> None:
    told = settings(TRAIN, load("config/can.yaml")[0].fieldbus.profile(0))
    assert [(each.index, each.subindex, each.value, each.size) for each in told] == [
        (0x6040, 0, 0, 2),
        (0x3001, 1, 8000, 4),
        (0x3001, 2, 16000, 4),
        (0x3001, 4, 40, 2),
        (0x3001, 5, 71000, 4),
        (0x6076, 0, 568000, 4),
        (0x6080, 0, 5200, 4),
        (0x6085, 0, 190000, 4),
        (0x3010, 1, 1024, 4),
        (0x6071, 0, 0, 2),
        (0x60B2, 0, 0, 2),
        (0x6060, 0, 10, 1),
        (0x60C2, 1, 0, 1),
        (0x6007, 0, 3, 2),
        (0x605A, 0, 6, 2),
        (0x605B, 0, 0, 2),
        (0x605C, 0, 0, 2),
        (0x605E, 0, 2, 2),
    ]


def test_what_an_axis_does_not_state_is_not_written() -> None:
    epos4 = load("config/can.yaml")[0].fieldbus.profile(0)
    brake = Brake(torque=0.4, opening_ms=40.0, closing_ms=19.6)
    unstated = ("maximum_speed_rpm", "quick_stop_rpm_s", "thermal_time_constant")
    bare = TRAIN.motor.model_copy(update=dict.fromkeys(unstated))

    def written(train: DriveTrain) -> dict[tuple[int, int], int]:
        return {(each.index, each.subindex): each.value for each in settings(train, epos4)}

    own = {(0x3001, 4), (0x6080, 0), (0x6085, 0)}
    assert own <= written(TRAIN).keys()
    assert not own & written(TRAIN.model_copy(update={"motor": bare})).keys()
    braked = written(TRAIN.model_copy(update={"brake": brake}))
    assert braked == written(TRAIN) | {(0x3158, 1): 40, (0x3158, 2): 20}


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"options.quick_stop": 7}, r"options.quick_stop \(0x605A\) is 7, .*choose one of 0, 1, 2"),
        ({"options": {"halt": 1}, "supported_options.halt": []}, "has no 0x605D; leave it out"),
        ({"settings.0.quantity": "motor.nominal_current"}, "either a value or a quantity"),
        ({"settings.0.unit": "mA"}, "a fixed value has no unit 'mA'; choose none"),
        ({"settings.0.value": 1 << 16}, "65536 does not fit 2 bytes"),
        ({"scaling.torque": 0x6077}, "0x6077"),
        ({"errors.0.last": 0x1000}, "must run forward"),
        ({"errors.1.code": 0x2310}, "0x2310 is given twice"),
        ({"ethercat.pdo_entries": 1}, "a PDO of the drive holds 1"),
    ],
)
def test_a_profile_that_contradicts_itself_is_one_line(changed: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigError, match=why) as refused:
        profile(**changed)
    assert "\n" not in str(refused.value)
    # What is wrong with an override alone stands in no file.
    assert refused.value.file.endswith("drives/cia402.yaml") or refused.value.file == "overrides"


def test_a_profile_that_is_not_there_is_named_with_those_that_are() -> None:
    key = "fieldbus.channels.0.drives.0.profile"
    with pytest.raises(
        ConfigError, match="axis 0: there is no drive profile 'epos5'; known: epos4"
    ):
        load("config/mixed_drives.yaml", overrides={key: "epos5"})


def test_a_quantity_that_its_object_cannot_hold_is_refused() -> None:
    narrow = profile(
        settings=[
            {"index": 0x6075, "length": 1, "quantity": "motor.nominal_current", "unit": "mA",
             "why": "rated current"}
        ]
    )  # fmt: skip
    with pytest.raises(DriverError, match=r"0x6075:0 \(rated current\) is 8000, .* fit 1 bytes"):
        settings(TRAIN, narrow)


def test_torque_and_position_are_scaled_by_what_the_drive_says() -> None:
    ratio, motor = TRAIN.gearbox.ratio, TRAIN.motor
    assert scale({}) == Scale.of(TRAIN)
    by_torque = scale({(0x6076, 0): 310}, torque="0x6076")
    assert by_torque.newton_metre_per_mille == pytest.approx(0.310e-3 * ratio)
    most = motor.current_limit * motor.torque_constant
    assert by_torque.mille_limit == int(1000 * most / 0.310)
    by_current = scale({(0x6075, 0): 4200}, torque="0x6075", sign=-1)
    assert by_current.newton_metre_per_mille == pytest.approx(-4.2e-3 * 0.071 * ratio)
    plain = scale({(0x608F, 1): 20000, (0x608F, 2): 2}, position="0x608F")
    assert plain.radian_per_increment == pytest.approx(2 * pi / (10000 * ratio))
    geared = {(0x608F, 1): 2000, (0x608F, 2): 1, (0x6091, 1): 4, (0x6091, 2): 1}
    assert scale(geared, position="0x608F").radian_per_increment == pytest.approx(
        2 * pi / (500 * ratio)
    )
    feed = geared | {(0x6092, 1): 36000, (0x6092, 2): 1}
    assert scale(feed, position="0x6092").radian_per_increment == pytest.approx(
        2 * pi / (9000 * ratio)
    )


def test_a_drive_that_is_not_set_up_is_refused() -> None:
    with pytest.raises(DriverError, match="0x6076:0 reads 0, so the drive's scale is unknown"):
        scale({(0x6076, 0): 0}, torque="0x6076")
    with pytest.raises(SdoAbortError, match="does not exist"):
        scale({}, position="0x608F")


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"settings.0.index": 0x2FFF}, "cia402.eds: object 0x2FFF:0 is not there"),
        ({"settings.0.length": 4}, "cia402.eds: object 0x6040:0 has 2 bytes, the profile has 4"),
        ({"settings.0.index": 0x6041}, "cia402.eds: object 0x6041:0 is ro"),
        ({"rpdo": [0x60400010, 0x60710010, 0x60770010]}, "0x6077:0 cannot be mapped into a rece"),
        ({"interpolation_ms": 0}, "cia402.eds: object 0x60C2:1 is not there"),
        ({"scaling.position": "0x6092"}, "cia402.eds: object 0x6092:1 is not there"),
        ({"eds.text": "[a"}, "cia402.eds: is no EDS"),
    ],
)
def test_a_profile_is_checked_against_its_data_sheet(changed: dict[str, Any], why: str) -> None:
    overrides = {f"{DRIVE}.{key}": value for key, value in changed.items()}
    config, _ = load("config/mixed_drives.yaml", overrides=overrides)
    found = [each for each in check(config, HOLD) if each.rule == "data sheet"]
    assert [each.ok for each in found] == [False]
    assert why in found[0].text
    assert found[0].where == "fieldbus.drive.eds"


def test_a_drive_without_heartbeat_consumer_is_for_a_lab_only() -> None:
    without = {f"{DRIVE}.watches_master": False}
    config, _ = load("config/mixed_drives.yaml", overrides=without)
    for place, fine in ((config, True), (config.model_copy(update={"lab": None}), False)):
        found = [each for each in check(place, HOLD) if each.where == f"{DRIVE}.watches_master"]
        assert [each.ok for each in found] == [fine]


def test_the_public_name_is_the_profile_of_an_axis() -> None:
    assert isinstance(CAN.fieldbus.profile(0), tonus.DriveProfile)


def test_every_key_of_a_profile_is_on_its_page() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "drive_profiles.md").read_text()
    models = (DriveProfile, DriveSetting, Scaling, DriveOptions, DriveError, EthercatPart)
    for key in {key for model in models for key in model.model_fields} | set(UNIT_OF):
        assert f"`{key}`" in page, key
