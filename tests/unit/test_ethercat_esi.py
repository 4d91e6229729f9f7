"""`tonus export esi`: what a file says is what the slave answers."""

from __future__ import annotations

import struct
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner
from ethercat_bench import SegmentBench

from tonus.tools.cli.export import export as command


def export(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(command, ["esi", *arguments])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> ET.Element:
    out = tmp_path_factory.mktemp("esi")
    code, said = export("config/ethercat.yaml", "--out", str(out))
    assert code == 0, said
    names = sorted(Path(line).name for line in said.split("\n") if line)
    assert names == ["epos4.xml", "force_amplifier_1_channel.xml", "force_amplifier_8_channels.xml"]
    found = ET.parse(out / "epos4.xml").find(".//Device")
    assert found is not None
    return found


def number(text: str | None) -> int:
    assert text is not None
    return int(text.replace("#x", "0x"), 0)


def test_the_identity_is_the_eeproms(device: ET.Element) -> None:
    bench = SegmentBench()
    bench.address()
    bench.write(0, 0x502, struct.pack("<HI", 0x0100, 10))
    product, revision = struct.unpack("<II", bench.read(0, 0x508, 8))
    kind = device.find("Type")
    assert kind is not None
    assert number(kind.get("ProductCode")) == product
    assert number(kind.get("RevisionNo")) == revision


def test_the_sync_managers_it_tells_of_are_taken(device: ET.Element) -> None:
    bench = SegmentBench()
    bench.address()
    blocks = [
        (
            number(sm.get("StartAddress")),
            int(sm.get("DefaultSize") or 0),
            number(sm.get("ControlByte")),
        )
        for sm in device.findall("Sm")
    ]
    for place, (start, size, control) in enumerate(blocks):
        bench.manager(0, place, start, size, control)
    for state in (2, 4, 8):
        assert bench.request(0, state) == (state, 0)


def test_every_object_is_read_as_it_stands_there(device: ET.Element) -> None:
    bench = SegmentBench()
    bench.pre_op(0)
    types = {one.findtext("Name"): one for one in device.findall(".//DataTypes/DataType")}
    listed = device.findall(".//Objects/Object")
    objects = bench.slaves[0].device.objects
    assert {number(one.findtext("Index")) for one in listed} == {i for i, _ in objects.entries}
    for one in listed:
        index = number(one.findtext("Index"))
        parts = types[one.findtext("Type")].findall("SubItem")
        for part in parts or [one]:
            sub = int(part.findtext("SubIdx") or 0)
            if part.findtext("Flags/Access") == "wo":
                continue
            assert 8 * len(bench.upload(0, index, sub)) == int(part.findtext("BitSize") or 0)


def test_a_bus_without_slaves_is_refused_in_one_line() -> None:
    result = CliRunner().invoke(command, ["esi", "config/can.yaml"])
    assert result.exit_code != 0
    assert "canopen" in f"{result.output}{result.exception}"
