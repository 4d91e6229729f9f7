"""The EDS files against the devices they describe, read by an independent parser."""

from __future__ import annotations

import struct
from importlib.resources import files

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes
from lab_bench import Bench

from tonus.config import load
from tonus.sim.can.canopen.node import Node
from tonus.sim.devices.device import Device
from tonus.sim.devices.epos4.drive import Epos4
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.lab.data_sheets import sheets

NODE = 9
FILES = ("epos4.eds", "force_cell.eds", "force_cell_4.eds")
LETTERS = {
    datatypes.INTEGER8: "b",
    datatypes.INTEGER16: "h",
    datatypes.INTEGER32: "i",
    datatypes.UNSIGNED8: "B",
    datatypes.UNSIGNED16: "H",
    datatypes.UNSIGNED32: "I",
    datatypes.UNSIGNED64: "Q",
    datatypes.REAL32: "f",
}
READ_ONLY, WRITE_ONLY = 0x06010002, 0x06010001


def variables(name: str) -> list[ODVariable]:
    path = files("tonus.sim.devices") / name
    dictionary = canopen.import_od(str(path), node_id=NODE)
    found = []
    for item in dictionary.values():
        found += [item] if isinstance(item, ODVariable) else list(item.values())
    return found


class Sheet:
    """The device of a file, alone on a channel of a lab."""

    def __init__(self, bench: Bench, name: str) -> None:
        lab = bench.lab
        assert bench.config.lab is not None
        noise = bench.config.lab.noise.force_cell
        device: Device
        if name == "epos4.eds":
            device = Epos4(0, NODE, lab.samples, lab)
        else:
            cells = (0,) if name == "force_cell.eds" else (0, 1, 2, 3)
            device = ForceCell(cells, NODE, lab.samples, noise, lab)
        self.node = Node(device, NODE, lab.channels["can0"], lab)
        self.node.boot()
        bench.wait(2)


@pytest.mark.parametrize("name", FILES)
def test_the_files_are_what_the_devices_are_now(name: str) -> None:
    made = sheets(load("config/can.yaml")[0])
    shipped = (files("tonus.sim.devices") / name).read_text()
    assert shipped == made[name], "the device has changed: write the files anew (tonus export eds)"


def upload(bench: Bench, index: int, sub: int) -> bytes | int:
    """Data, expedited or in segments, or the abort code."""
    answer = bench.request("can0", NODE, struct.pack("<BHB4x", 0x40, index, sub))
    if answer[0] == 0x80:
        return int.from_bytes(answer[4:], "little")
    if answer[0] & 2:
        return answer[4 : 8 - (answer[0] >> 2 & 3)]
    (size,) = struct.unpack_from("<I", answer, 4)
    data, toggle = b"", 0
    while len(data) < size:
        part = bench.request("can0", NODE, bytes((0x60 | toggle << 4,)) + bytes(7))
        data += part[1 : 8 - (part[0] >> 1 & 7)]
        toggle ^= 1
    return data


@pytest.mark.parametrize("name", FILES)
def test_every_object_is_as_its_sheet_says(name: str) -> None:
    with Bench() as bench:
        sheet = Sheet(bench, name)
        described = variables(name)
        keys = {(var.index, var.subindex) for var in described}
        assert keys == set(sheet.node.device.objects.entries), "all, and no more"
        for var in described:
            where = f"0x{var.index:04X}:{var.subindex}"
            data = upload(bench, var.index, var.subindex)
            if var.access_type == "wo":
                assert data == WRITE_ONLY, where
            else:
                assert isinstance(data, bytes), where
                if var.data_type == datatypes.VISIBLE_STRING:
                    assert data.decode() == var.default, where
                    continue
                letter = LETTERS[var.data_type]
                assert len(data) == struct.calcsize(letter), where
                (value,) = struct.unpack("<" + letter, data)
                if var.default is not None:
                    assert value == var.default, where
            if var.access_type in ("ro", "const"):
                size = struct.calcsize(LETTERS[var.data_type])
                refused = bench.write("can0", NODE, var.index, var.subindex, 0, min(size, 4))
                assert refused == READ_ONLY, where


@pytest.mark.parametrize("name", FILES)
def test_every_limit_is_the_devices(name: str) -> None:
    with Bench() as bench:
        Sheet(bench, name)
        checked = 0
        for var in variables(name):
            letter = LETTERS.get(var.data_type, "")
            if letter in "fQ" or var.access_type not in ("rw", "rww"):
                continue
            size = struct.calcsize(letter)
            for limit, beyond in ((var.min, -1), (var.max, 1)):
                if limit is None:
                    continue
                low, high = (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1)
                if letter.isupper():
                    low, high = 0, (1 << 8 * size) - 1
                if low <= limit + beyond <= high:
                    code = bench.write("can0", NODE, var.index, var.subindex, limit + beyond, size)
                    assert code == 0x06090030, f"0x{var.index:04X}:{var.subindex}"
                    checked += 1
        assert checked > (60 if name == "epos4.eds" else 1)


def test_the_identifiers_follow_the_node() -> None:
    dictionary = canopen.import_od(str(files("tonus.sim.devices") / "epos4.eds"), node_id=NODE)
    assert dictionary[0x1014].default == 0x80 + NODE
    assert dictionary[0x1400][1].default == 0x200 + NODE
    assert dictionary[0x1800][1].default == 0x40000180 + NODE
    assert dictionary[0x1802][1].default == 0xC0000380 + NODE
    assert dictionary[0x1200][2].default == 0x580 + NODE
    assert dictionary[0x1017].default == 0


def test_the_sheet_names_the_maker_and_its_bit_rates() -> None:
    information = canopen.import_od(
        str(files("tonus.sim.devices") / "epos4.eds"), node_id=NODE
    ).device_information
    assert information.vendor_number == 0xFB
    assert information.product_number == 0x65510000
    assert information.revision_number == 0x01700000
    assert information.nr_of_RXPDO == information.nr_of_TXPDO == 4
    rates = {20, 50, 125, 250, 500, 800, 1000}
    assert information.allowed_baudrates == {1000 * rate for rate in rates}


def test_mappable_objects_say_so() -> None:
    dictionary = canopen.import_od(str(files("tonus.sim.devices") / "epos4.eds"), node_id=NODE)
    assert dictionary[0x6071].access_type == dictionary[0x607A].access_type == "rww"
    assert dictionary[0x6041].access_type == "ro"
    assert dictionary[0x6041].pdo_mappable
    assert not dictionary[0x605A].pdo_mappable
