"""A drive made from its EDS: it has that dictionary, and does what CiA 402 says."""

from __future__ import annotations

from pathlib import Path

import pytest

from tonus.config import load
from tonus.config.schema.lab import LabScript
from tonus.sim.devices.cia402.states import State
from tonus.sim.devices.eds.drive import EdsDrive
from tonus.sim.devices.eds.sheet import Sheet, read
from tonus.sim.devices.objects import RANGE, READ_ONLY, AbortError, Kind
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab

SHEETS = Path(__file__).resolve().parents[1] / "eds"
CONFIG = load("config/direct.yaml")[0]
MOTOR = CONFIG.robot.motor
NODE = 5
ENABLE = (0x06, 0x0F)


def sheet(name: str) -> Sheet:
    return read(name, (SHEETS / name).read_text(encoding="ascii"), NODE)


class Stand:
    """One drive from a sheet on a drum without a cable."""

    def __init__(self, name: str, *, feed: bool = False) -> None:
        self.lab = Lab(CONFIG, LabScript(), seed=1, clock=lambda: 0)
        self.lab.plant.cut_cable(0)
        self.drive = EdsDrive(0, sheet(name), MOTOR, self.lab.samples, self.lab, feed=feed)
        self.errors: list[tuple[int, int]] = []
        self.drive.on_error = lambda code, register: self.errors.append((code, register))
        self.drive.set_operational(True)

    def write(self, index: int, value: int, sub: int = 0) -> None:
        size = self.drive.objects.find(index, sub).kind.size
        self.drive.objects.write(index, sub, value.to_bytes(size, "little", signed=value < 0))

    def enable(self) -> None:
        self.write(0x6060, 10)
        for word in ENABLE:
            self.write(0x6040, word)
        assert self.drive.enabled

    def wait(self, ms: int) -> None:
        self.lab.advance(self.lab.now_ns + ms * 1_000_000)


@pytest.fixture
def stand() -> Stand:
    return Stand("servo_a.eds")


def test_a_sheet_is_read_with_types_access_defaults_and_limits() -> None:
    entries = sheet("servo_b.eds").entries
    target = entries[0x6071, 0]
    assert (target.kind, target.low, target.high) == (Kind.I16, -1000, 1000)
    assert (target.access, target.mapping, target.value) == ("rw", "rt", 0)
    assert entries[0x203B, 2].value == -1
    assert entries[0x1400, 1].value == 0x200 + NODE
    assert entries[0x1400, 1].relative
    assert entries[0x1800, 1].value == 0x40000180 + NODE
    assert [entries[0x608F, sub].value for sub in range(3)] == [2, 2000, 1]
    assert entries[0x608F, 1].name == "Encoder increments"
    assert entries[0x1003, 8].access == "ro"
    octal = sheet("servo_a.eds").entries
    assert octal[0x608F, 1].value == 0o10000
    assert octal[0x6040, 0].mapping == "r"
    assert octal[0x6060, 0].value == -1
    assert octal[0x1F50, 0].access == "wo"


@pytest.mark.parametrize("name", ["servo_a.eds", "servo_b.eds"])
def test_the_drive_has_the_sheets_objects_and_no_other(name: str) -> None:
    objects, found = Stand(name).drive.objects, sheet(name).entries
    own = {key for key in found if not 0x1400 <= key[0] < 0x1C00}
    assert set(objects.entries) == own
    for key in own:
        entry, made = found[key], objects.find(*key)
        assert (made.kind, made.access, made.mapping) == (entry.kind, entry.access, entry.mapping)
        if entry.access in ("ro", "const"):
            with pytest.raises(AbortError) as refused:
                objects.write(*key, bytes(entry.kind.size))
            assert refused.value.code == READ_ONLY


def test_a_value_beyond_the_sheets_limit_is_refused() -> None:
    stand = Stand("servo_b.eds")
    stand.write(0x6071, 1000)
    with pytest.raises(AbortError) as refused:
        stand.write(0x6071, 1001)
    assert refused.value.code == RANGE


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("[6071]", "[5071]", r"servo_a.eds: has no object 0x6071:0 \(target torque\)"),
        ("[1017]", "[5017]", r"servo_a.eds: has no object 0x1017:0 \(producer heartbeat time\)"),
        ("DataType=0x0006", "DataType=0x0016", "servo_a.eds: object 0x1017:0: data type 0x0016"),
        ("DefaultValue=0x20192", "DefaultValue=two", "object 0x1000:0: 'two' is no number"),
        ("DefaultValue=0x3FF", "DefaultValue=0x1FF", "object 0x6502:0: 0x1FF lacks bit 9"),
        ("AccessType=rww", "AccessType=all", "object 0x6040:0: access type 'all' is unknown"),
        ("[DeviceInfo]", "[Device]", "has no section DeviceInfo"),
        ("[FileInfo]", "FileInfo]", "servo_a.eds: is no EDS"),
    ],
)
def test_a_sheet_that_cannot_be_emulated_is_one_line(old: str, new: str, why: str) -> None:
    text = (SHEETS / "servo_a.eds").read_text(encoding="ascii")
    assert old in text
    lab = Lab(CONFIG, LabScript(), seed=1, clock=lambda: 0)
    with pytest.raises(LabError, match=why) as refused:
        EdsDrive(0, read("servo_a.eds", text.replace(old, new, 1), NODE), MOTOR, lab.samples, lab)
    assert "\n" not in str(refused.value)
    assert "; " in str(refused.value)


def test_what_the_sheet_leaves_open_is_as_on_the_robots_motor(stand: Stand) -> None:
    number = stand.drive.objects.number
    assert number(0x6075, 0) == 8000
    assert number(0x6076, 0) == 568
    assert number(0x6072, 0) == 2000
    assert number(0x608F, 1) == 0o10000
    assert number(0x6085, 0) > 0


def test_per_mille_of_the_rated_torque_become_the_motors_current(stand: Stand) -> None:
    stand.enable()
    stand.write(0x6071, 250)
    stand.wait(1)
    rated = 568e-3 / MOTOR.torque_constant
    assert stand.lab.plant.current_reference[0] == pytest.approx(0.25 * rated)
    stand.write(0x6076, 284)
    stand.wait(1)
    assert stand.lab.plant.current_reference[0] == pytest.approx(0.125 * rated)
    stand.write(0x6071, 32000)
    stand.wait(1)
    assert stand.lab.plant.current_reference[0] <= MOTOR.current_limit + 1e-9


@pytest.mark.parametrize(("feed", "counts"), [(False, 2000 / 4), (True, 36000 / 4)])
def test_positions_count_as_the_sheets_objects_say(feed: bool, counts: float) -> None:
    stand = Stand("servo_b.eds", feed=feed)
    stand.enable()
    stand.write(0x6071, 50)
    stand.wait(300)
    turned = float(stand.lab.plant.motor_angle[0])
    found = int.from_bytes(stand.drive.objects.read(0x6064, 0), "little", signed=True)
    assert abs(turned) > 1.0
    assert found == pytest.approx(turned * counts / 6.283185307179586, abs=1.5)


def test_without_a_mode_nothing_moves(stand: Stand) -> None:
    stand.write(0x6060, 0)
    stand.write(0x6071, 500)
    for word in ENABLE:
        stand.write(0x6040, word)
    stand.wait(20)
    assert stand.drive.enabled
    assert stand.lab.plant.current_reference[0] == 0.0


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.SWITCH_ON_DISABLED),
        (2, State.SWITCH_ON_DISABLED),
        (6, State.QUICK_STOP_ACTIVE),
    ],
)
def test_a_quick_stop_ends_as_its_option_has_it(stand: Stand, option: int, state: State) -> None:
    stand.write(0x605A, option)
    stand.enable()
    stand.write(0x6071, 100)
    stand.wait(50)
    stand.write(0x6040, 0x02)
    assert stand.drive.state is (state if option == 0 else State.QUICK_STOP_ACTIVE)
    stand.wait(3000)
    assert stand.drive.state is state


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.OPERATION_ENABLED),
        (1, State.FAULT),
        (2, State.SWITCH_ON_DISABLED),
        (3, State.QUICK_STOP_ACTIVE),
    ],
)
def test_a_lost_master_is_answered_as_0x6007_has_it(
    stand: Stand, option: int, state: State
) -> None:
    stand.write(0x6007, option)
    stand.write(0x605A, 6)
    stand.enable()
    stand.drive.fail(0x8130)
    stand.wait(3000)
    assert stand.drive.state is state
    assert stand.errors == [(0x8130, 0x11)]


def test_a_fault_shows_its_code_and_ends_with_a_reset(stand: Stand) -> None:
    stand.enable()
    stand.drive.fail(0x7305)
    stand.wait(3000)
    assert stand.drive.state is State.FAULT
    assert stand.drive.objects.number(0x603F, 0) == 0x7305
    assert stand.errors == [(0x7305, 0x21)]
    for word in (0x00, 0x80):
        stand.write(0x6040, word)
    assert stand.drive.state is State.SWITCH_ON_DISABLED
    assert stand.drive.objects.number(0x603F, 0) == 0
    assert stand.errors[-1] == (0, 0)
    with pytest.raises(KeyError):
        stand.drive.fail(0x10000)
