"""python-canopen's SDO client: what our drives grant, and what they refuse with which code."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from canopen_client import CST, Drive, dictionary
from running_lab import CELLS

pytestmark = pytest.mark.realtime

NO_OBJECT, NO_SUB, READ_ONLY, RANGE = 0x06020000, 0x06090011, 0x06010002, 0x06090030
LENGTH, TOO_SHORT, SUB0, NOT_MAPPABLE = 0x06070010, 0x06070013, 0x06010003, 0x06040041
PDO_LENGTH, INCOMPATIBLE, CANNOT_STORE, STATE = 0x06040042, 0x06040043, 0x08000020, 0x08000022
TOGGLE, COMMAND, NMT_STATE = 0x05030000, 0x05040001, 0x0F00FFC0


def write(index: int, sub: int, size: int, value: int) -> Callable[[Drive], object]:
    data = value.to_bytes(size, "little", signed=value < 0)
    return lambda drive: drive.sdo.download(index, sub, data)


def read(index: int, sub: int) -> Callable[[Drive], object]:
    return lambda drive: drive.sdo.upload(index, sub)


def raw(*frames: bytes) -> Callable[[Drive], object]:
    """Requests as they are; the last one is to be refused."""
    return lambda drive: [drive.sdo.request_response(frame.ljust(8, b"\0")) for frame in frames]


def unmapped(area: int, *writes: Callable[[Drive], object]) -> Callable[[Drive], object]:
    """The writes, after PDO 1 of an area was made invalid and empty."""
    cob = 0x80000201 if area == 0x1600 else 0xC0000181

    def act(drive: Drive) -> None:
        write(area - 0x200, 1, 4, cob)(drive)
        write(area, 0, 1, 0)(drive)
        for one in writes:
            one(drive)

    return act


def operational(act: Callable[[Drive], object]) -> Callable[[Drive], object]:
    def then(drive: Drive) -> None:
        drive.command("OPERATIONAL")
        act(drive)

    return then


def powered(act: Callable[[Drive], object]) -> Callable[[Drive], object]:
    def then(drive: Drive) -> None:
        drive.op_mode = CST
        drive.state = "OPERATION ENABLED"
        act(drive)

    return then


@dataclass(frozen=True)
class Refusal:
    what: str
    act: Callable[[Drive], object]
    code: int


REFUSALS = [
    Refusal("read an object nobody has", read(0x4711, 0), NO_OBJECT),
    Refusal("read the maximal torque, which an EPOS4 has not", read(0x6072, 0), NO_OBJECT),
    Refusal("write the SYNC period, which it has not", write(0x1006, 0, 4, 1000), NO_OBJECT),
    Refusal("read the tenth part of the identity", read(0x1018, 9), NO_SUB),
    Refusal("read a part of a variable", read(0x6041, 1), NO_SUB),
    Refusal("write a motor datum it has not", write(0x3001, 9, 4, 1), NO_SUB),
    Refusal("write the device type", write(0x1000, 0, 4, 1), READ_ONLY),
    Refusal("write the vendor", write(0x1018, 1, 4, 1), READ_ONLY),
    Refusal("write the statusword", write(0x6041, 0, 2, 0x27), READ_ONLY),
    Refusal("write the position", write(0x6064, 0, 4, 0), READ_ONLY),
    Refusal("write the rated torque", write(0x6076, 0, 4, 1), READ_ONLY),
    Refusal("write the SYNC identifier", write(0x1005, 0, 4, 0x81), READ_ONLY),
    Refusal("a mode CiA 402 has and the drive has not", write(0x6060, 0, 1, 2), RANGE),
    Refusal("homing on the spot by its new number", write(0x6098, 0, 1, 35), RANGE),
    Refusal("a quick stop that coasts", write(0x605A, 0, 2, 2), RANGE),
    Refusal("no reaction to a lost connection", write(0x6007, 0, 2, 0), RANGE),
    Refusal("more current than the power stage has", write(0x3001, 2, 4, 30_001), RANGE),
    Refusal("an interpolation period above 100 ms", write(0x60C2, 1, 1, 101), RANGE),
    Refusal("a history that is set to one error", write(0x1003, 0, 1, 1), RANGE),
    Refusal("no profile velocity", write(0x6081, 0, 4, 0), RANGE),
    Refusal("a reserved transmission type", write(0x1800, 2, 1, 241), RANGE),
    Refusal("a torque of twenty bytes", write(0x6071, 0, 20, 0), LENGTH),
    Refusal("a mode of two bytes", write(0x6060, 0, 2, 10), LENGTH),
    Refusal("a speed of two bytes", write(0x6080, 0, 2, 100), TOO_SHORT),
    Refusal("a torque of one byte", write(0x6071, 0, 1, 1), TOO_SHORT),
    Refusal("a mapping while its count stands", write(0x1600, 1, 4, 0x60400010), SUB0),
    Refusal("a count while the PDO is valid", write(0x1600, 0, 1, 0), INCOMPATIBLE),
    Refusal("a name in a TPDO", unmapped(0x1A00, write(0x1A00, 1, 4, 0x10080020)), NOT_MAPPABLE),
    Refusal(
        "a statusword in an RPDO", unmapped(0x1600, write(0x1600, 1, 4, 0x60410010)), NOT_MAPPABLE
    ),
    Refusal("nothing in a TPDO", unmapped(0x1A00, write(0x1A00, 0, 1, 8)), NOT_MAPPABLE),
    Refusal(
        "an object nobody has in a TPDO",
        unmapped(0x1A00, write(0x1A00, 1, 4, 0x47110010)),
        NO_OBJECT,
    ),
    Refusal(
        "twelve bytes in a TPDO",
        unmapped(
            0x1A00,
            *(write(0x1A00, place, 4, 0x60640020) for place in (1, 2, 3)),
            write(0x1A00, 0, 1, 3),
        ),
        PDO_LENGTH,
    ),
    Refusal("storing without the word for it", write(0x1010, 1, 4, 1), CANNOT_STORE),
    Refusal("restoring with the word for storing", write(0x1011, 1, 4, 0x65766173), CANNOT_STORE),
    Refusal("an identifier in operation", operational(write(0x1400, 1, 4, 0x80000201)), NMT_STATE),
    Refusal("a type in operation", operational(write(0x1800, 2, 1, 1)), NMT_STATE),
    Refusal("an encoder under power", powered(write(0x3010, 1, 4, 1000)), STATE),
    Refusal("a motor type under power", powered(write(0x6402, 0, 2, 1)), STATE),
    Refusal("a segment with the wrong toggle", raw(b"\x40\x08\x10", b"\x70"), TOGGLE),
    Refusal(
        "the same segment twice",
        raw(b"\x21\x71\x60\0\x08", b"\0aaaaaaa", b"\0aaaaaaa"),
        TOGGLE,
    ),
    Refusal("a segment of nothing", raw(b"\x60"), COMMAND),
    Refusal("more of nothing", raw(b"\0"), COMMAND),
    Refusal("a command CiA 301 has not", raw(b"\xe0\x00\x10"), COMMAND),
    Refusal("less than was announced", raw(b"\x21\x71\x60\0\x08", b"\x01aaaaaaa"), LENGTH),
]


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda refusal: refusal.what)
def test_what_is_refused_and_why(drive: Drive, refusal: Refusal) -> None:
    code = drive.refused(lambda: refusal.act(drive))
    assert f"{code:08X}" == f"{refusal.code:08X}"
    # The server has forgotten it, and goes on.
    assert drive.sdo[0x1008].raw == "EPOS4"


def test_the_refusals_are_many() -> None:
    assert len(REFUSALS) >= 20
    assert len({refusal.code for refusal in REFUSALS}) >= 12


@pytest.mark.parametrize("way", ["rb", "wb"])
def test_block_transfer_is_refused(drive: Drive, way: str) -> None:
    code = drive.refused(lambda: drive.sdo.open(0x6065, 0, way, size=4, block_transfer=True))
    assert code == COMMAND
    assert drive.sdo[0x1008].raw == "EPOS4"


@pytest.mark.parametrize("segmented", [False, True])
def test_every_size_is_written_and_read_back(drive: Drive, segmented: bool) -> None:
    for index, sub, data in (
        (0x6060, 0, b"\x09"),
        (0x60B2, 0, struct.pack("<h", -1234)),
        (0x6065, 0, struct.pack("<I", 0xFEDCBA98)),
        (0x607A, 0, struct.pack("<i", -70_000)),
        (0x3001, 2, struct.pack("<I", 12_345)),
        (0x3001, 3, b"\x07"),
    ):
        drive.sdo.download(index, sub, data, force_segment=segmented)
        assert drive.sdo.upload(index, sub) == data


def test_a_transfer_that_its_client_aborts_leaves_no_trace(drive: Drive) -> None:
    before = drive.number(0x6065)
    drive.sdo.request_response(b"\x21\x65\x60\0\x04\0\0\0")
    drive.sdo.abort(0x08000000)
    assert drive.refused(lambda: raw(b"\x07\x01\x02\x03\x04")(drive)) == COMMAND
    assert drive.number(0x6065) == before


def test_a_new_transfer_ends_the_one_before(drive: Drive) -> None:
    drive.sdo.request_response(b"\x21\x65\x60\0\x04\0\0\0")
    assert drive.number(0x1018, 1) == 0xFB
    assert drive.refused(lambda: raw(b"\x07\x01\x02\x03\x04")(drive)) == COMMAND


def test_two_clients_on_one_bus_read_two_drives_at_once(drive: Drive, lab: object) -> None:
    other = canopen.Network()
    other.NOTIFIER_CYCLE = 0.05
    other.connect(interface="tonus", channel="can0")
    second = other.add_node(7, dictionary(7))
    for _ in range(20):
        assert drive.sdo[0x1008].raw == second.sdo[0x1008].raw == "EPOS4"
        assert drive.number(0x1200, 1) == 0x601
        assert second.sdo.upload(0x1200, 1) == struct.pack("<I", 0x607)
    other.disconnect()


def variables(objects: canopen.ObjectDictionary) -> list[ODVariable]:
    found = []
    for entry in objects.values():
        found += [entry] if isinstance(entry, ODVariable) else list(entry.values())
    return found


def test_every_object_of_the_dictionary_is_there_and_of_its_type(drive: Drive) -> None:
    """What can be read has its type's length; what can only be read refuses to be written."""
    known = variables(drive.object_dictionary)
    assert len(known) > 60
    for variable in known:
        if not variable.readable:
            continue
        data = drive.sdo.upload(variable.index, variable.subindex)
        if variable.fixed_size:
            assert len(data) == len(variable) // 8, variable
        if not variable.writable:
            code = drive.refused(
                lambda v=variable, d=data: drive.sdo.download(v.index, v.subindex, d)
            )
            assert code == READ_ONLY, variable


def test_force_cells_measure_in_newtons(networks: dict[str, canopen.Network]) -> None:
    for name, cells in CELLS.items():
        for number in cells:
            node = networks[name].add_node(number, canopen.ObjectDictionary())
            assert node.sdo.upload(0x1000, 0) == struct.pack("<I", 0x00020194)
            assert node.sdo.upload(0x6131, 1) == struct.pack("<I", 0x00210000)
            (force,) = struct.unpack("<f", node.sdo.upload(0x6130, 1))
            (hundredths,) = struct.unpack("<i", node.sdo.upload(0x9130, 1))
            assert abs(force - hundredths / 100) < 1.0  # two samples, noise between
            with pytest.raises(canopen.SdoAbortedError) as refused:
                node.sdo.download(0x6130, 1, bytes(4))
            assert refused.value.code == READ_ONLY
            del networks[name][number]
