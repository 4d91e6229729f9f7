"""SOEM, through pysoem and nothing of ours, against `tonus lab` on a pair of network interfaces.

Skipped, with the reason, where pysoem is missing or the host allows no such pair.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import time  # noqa: TID251 - a real master on the real clock
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from door_client import ask, inject

from tonus.config.document import read

pysoem = pytest.importorskip("pysoem", reason="pysoem is not installed: the extra ethercat")
pytestmark = pytest.mark.realtime

DRIVES = 8
EXPECTED = 3 * DRIVES + 2
RPDO = (0x60400010, 0x60710010)
TPDO = (0x60410010, 0x60640020, 0x60770010)
OP, SAFE_OP, PRE_OP = 8, 4, 2
ANSWER_US = 20_000
"""for a frame and its repetitions; SOEM's own 2 ms leave no time for one, and a host may take it"""
TRIES = 3


def obstacle() -> str:
    """Why there can be no pair of interfaces here; empty: there can."""
    command = shutil.which("ip")
    if command is None:
        return "there is no ip command"
    if os.geteuid() != 0:
        return "a pair of network interfaces needs root"
    name = f"probe{os.getpid() % 10000}"
    made = subprocess.run(
        [command, "link", "add", name, "type", "veth", "peer", "name", f"{name}b"],
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        return f"the host makes no veth pair: {made.stderr.strip()}"
    subprocess.run([command, "link", "del", name], check=False, capture_output=True)
    return ""


class Bench:
    """A lab in its own process, and SOEM on the other end of its cable, or ``ring``: on both."""

    def __init__(self, directory: Path, ring: bool = False) -> None:
        reason = obstacle()
        if reason:
            pytest.skip(reason)
        number = os.getpid() % 10000
        kind = "r" if ring else "l"  # a ring has interfaces of its own
        self.near, self.far = f"t{kind}m{number}", f"t{kind}s{number}"
        self.directory = directory
        config = directory / "ethercat.yaml"
        config.write_text(_renamed(self.near, self.far, ring))
        self.ring = ring
        environment = {
            **os.environ,
            "TONUS_RUNTIME_DIR": str(directory),
            "PYTHONUNBUFFERED": "1",
        }
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tonus.tools.cli", "lab", str(config)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert "Ctrl-C" in line, line
        self.master: Any = None

    def close(self) -> None:
        if self.master is not None:
            self.master.close()
        self.process.terminate()
        self.process.wait(10)

    def order(self, **request: Any) -> dict[str, Any]:
        reply = ask(self.directory, **request)
        assert reply["ok"], reply["error"]
        return reply

    def repair(self) -> None:
        """No fault is left, and every slave has just been switched on."""
        self.order(op="clear")
        self.order(op="cut", n=DRIVES + 2)
        self.order(op="fault", f={"drop": 0, "drop_p": 0, "mute": 0, "drop_mbx": 0, "drop_mbxw": 0})
        for slave in range(DRIVES + 2):
            self.order(op="reject", slave=slave, map={})
            inject(self.directory, "power_cycle", channel=self.near, node=slave + 1)

    def open(self) -> Any:
        if self.master is not None:
            self.master.close()
        pysoem.settings.timeouts.ret = ANSWER_US
        self.master = pysoem.Master()
        self.master.open(self.near, *((f"{self.near}r",) if self.ring else ()))
        return self.master

    def init(self) -> Any:
        master = self.open()
        assert master.config_init() == DRIVES + 2
        return master

    def map(self) -> Any:
        master = self.init()
        for slave in master.slaves[:DRIVES]:
            slave.config_func = lambda position: _map_drive(master.slaves[position])
        master.config_map()
        assert master.state_check(SAFE_OP, 2_000_000) == SAFE_OP
        return master

    def operate(self) -> Any:
        master = self.map()
        self.exchange()
        master.state = OP
        master.write_state()
        assert self.until(lambda: master.state_check(OP, 1000) == OP), states(master)
        return master

    def exchange(self, timeout_us: int = 20_000) -> int:
        self.master.send_processdata()
        counter: int = self.master.receive_processdata(timeout_us)
        return counter

    def until(self, found: Callable[[], bool], seconds: float = 5.0) -> bool:
        """Exchange process data until it is so."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.exchange()
            if found():
                return True
            time.sleep(0.001)
        return False


def _renamed(near: str, far: str, ring: bool) -> str:
    """The shipped configuration on interfaces of this test's own."""
    folder = Path(__file__).resolve().parents[2] / "config"
    data = read(folder / "ethercat.yaml").data
    data["fieldbus"]["interface"] = near
    data["lab"]["ethercat"]["interface"] = far
    del data["sto_relay"]  # nobody here would hold it
    if ring:
        data["fieldbus"]["redundant_interface"] = f"{near}r"
        data["lab"]["ethercat"]["redundant_interface"] = f"{far}r"
    return yaml.safe_dump(data)


def _map_drive(slave: Any) -> None:
    for assignment, mapping, words in ((0x1C12, 0x1600, RPDO), (0x1C13, 0x1A00, TPDO)):
        _write(slave, assignment, 0, b"\0")
        _write(slave, mapping, 0, b"\0")
        for place, word in enumerate(words, start=1):
            _write(slave, mapping, place, struct.pack("<I", word))
        _write(slave, mapping, 0, bytes((len(words),)))
        _write(slave, assignment, 1, struct.pack("<H", mapping))
        _write(slave, assignment, 0, b"\1")


def _write(slave: Any, index: int, subindex: int, data: bytes) -> None:
    """Again, where a frame came too late for SOEM."""
    for _ in range(TRIES - 1):
        with suppress(pysoem.WkcError):
            slave.sdo_write(index, subindex, data)
            return
    slave.sdo_write(index, subindex, data)


def states(master: Any) -> list[tuple[int, int]]:
    master.read_state()
    return [(slave.state, slave.al_status) for slave in master.slaves]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp("segment"))
    yield bench
    bench.close()


@pytest.fixture
def bench(lab: Bench) -> Bench:
    lab.repair()
    return lab


def drain(slave: Any) -> None:
    """SOEM keeps what it has been told until it is asked."""
    for _ in range(10):
        try:
            slave.sdo_read(0x1018, 1)
        except (pysoem.SdoError, pysoem.MailboxError, pysoem.Emergency, pysoem.WkcError):
            continue
        return


# -- as it should be ---------------------------------------------------------------------------


def test_identity_and_objects(bench: Bench) -> None:
    master = bench.init()
    found = [(slave.man, slave.id, slave.rev) for slave in master.slaves]
    assert found[:DRIVES] == [(0xFB, 0x65510000, 0x01700000)] * DRIVES
    assert found[DRIVES:] == [(0xFFFF, 0x408, 1), (0xFFFF, 0x401, 1)]
    assert master.slaves[0].name == "EPOS4"
    assert master.state_check(PRE_OP, 2_000_000) == PRE_OP
    drive, amplifier = master.slaves[0], master.slaves[8]
    assert drive.sdo_read(0x1018, 2) == struct.pack("<I", 0x65510000)
    assert drive.sdo_read(0x1008, 0) == b"EPOS4"
    assert amplifier.sdo_read(0x1A00, 0, ca=True)[:2] == b"\x08\0"
    drive.sdo_write(0x210C, 1, struct.pack("<I", 0x12345678))
    assert drive.sdo_read(0x210C, 1) == struct.pack("<I", 0x12345678)
    serials = {slave.sdo_read(0x1018, 4) for slave in master.slaves}
    assert len(serials) == DRIVES + 2, "every slave has its own address"


def test_refused_accesses_come_with_their_code(bench: Bench) -> None:
    drive = bench.init().slaves[0]
    for act, code in (
        (lambda: drive.sdo_read(0x5FFF, 0), 0x06020000),
        (lambda: drive.sdo_write(0x6041, 0, b"\0\0"), 0x06010002),
        (lambda: drive.sdo_write(0x60C2, 1, b"\x65"), 0x06090030),
        (lambda: drive.sdo_read(0x1018, 0, ca=True), 0x06010004),
    ):
        with pytest.raises(pysoem.SdoError) as caught:
            act()
        assert caught.value.abort_code == code


def test_process_data_in_op_without_clocks(bench: Bench) -> None:
    master = bench.operate()
    assert states(master) == [(OP, 0)] * (DRIVES + 2)
    assert master.expected_wkc == EXPECTED
    for word, pattern in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        for slave in master.slaves[:DRIVES]:
            slave.output = struct.pack("<Hh", word, 0)
        assert bench.until(
            lambda pattern=pattern: all(
                struct.unpack_from("<H", slave.input)[0] & 0x6F == pattern
                for slave in master.slaves[:DRIVES]
            )
        )
    assert all(slave["drive_state"] == "OPERATION_ENABLED" for slave in _told(bench)[:DRIVES])
    force = struct.unpack_from("<8h", master.slaves[8].input)
    assert all(abs(value) < 5000 for value in force)
    counters = [bench.exchange() for _ in range(300)]
    assert counters.count(EXPECTED) >= 299


def _told(bench: Bench) -> list[dict[str, Any]]:
    slaves: list[dict[str, Any]] = bench.order(op="get")["slaves"]
    return slaves


def test_distributed_clocks(bench: Bench) -> None:
    master = bench.init()
    assert master.config_dc()
    for slave in master.slaves[:DRIVES]:
        slave.config_func = lambda position: _map_drive(master.slaves[position])
    for slave in master.slaves:
        slave.dc_sync(act=True, sync0_cycle_time=1_000_000)
    master.config_map()
    assert master.state_check(SAFE_OP, 2_000_000) == SAFE_OP
    master.state = OP
    master.write_state()
    assert bench.until(lambda: master.state_check(OP, 1000) == OP), states(master)
    before = master.dc_time
    assert bench.until(lambda: max(abs(s["clock_difference_ns"]) for s in _told(bench)) < 100)
    assert master.dc_time > before
    assert bench.until(lambda: min(slave["sync_pulses"] for slave in _told(bench)) > 200)


# -- as SOEM reports what is wrong -------------------------------------------------------------


def test_a_lost_frame_has_no_counter(bench: Bench) -> None:
    bench.operate()
    bench.order(op="fault", f={"drop": 1})
    assert bench.exchange(2000) == -1
    assert bench.exchange() == EXPECTED
    inject(bench.directory, "corruption", channel=bench.near, frames=1)
    assert bench.exchange(2000) == -1
    assert bench.exchange() == EXPECTED


def test_a_late_and_a_double_answer_do_no_harm(bench: Bench) -> None:
    bench.operate()
    inject(bench.directory, "delay", channel=bench.near, frames=1, delay_us=30_000)
    assert bench.exchange(2000) == -1
    time.sleep(0.05)
    assert [bench.exchange() for _ in range(20)] == [EXPECTED] * 20
    inject(bench.directory, "duplicate", channel=bench.near, frames=5)
    assert [bench.exchange() for _ in range(20)] == [EXPECTED] * 20


def test_a_state_drop_shows_in_the_state_and_not_in_the_counter(bench: Bench) -> None:
    master = bench.operate()
    bench.order(op="al", slave=2, state=4, code=27)
    assert bench.exchange() == EXPECTED
    assert states(master)[2] == (SAFE_OP | 0x10, 27)
    assert "watchdog" in pysoem.al_status_code_to_string(27).lower()
    slave = master.slaves[2]
    slave.state = OP | 0x10
    slave.write_state()
    assert bench.until(lambda: states(master)[2] == (OP, 0))


def test_a_cut_shows_in_the_counter_and_in_the_states(bench: Bench) -> None:
    master = bench.operate()
    bench.order(op="cut", n=4)
    assert bench.exchange() == 12
    master.read_state()
    assert [slave.state for slave in master.slaves[:4]] == [OP] * 4
    assert [slave.state for slave in master.slaves[4:]] == [0] * 6, "none is what SOEM calls it"
    bench.order(op="cut", n=DRIVES + 2)
    assert bench.exchange() == EXPECTED


def test_power_loss_shows_as_a_slave_that_is_to_be_configured_anew(bench: Bench) -> None:
    master = bench.operate()
    inject(bench.directory, "power_cycle", channel=bench.near, node=8)
    assert bench.exchange() == EXPECTED - 3
    master.read_state()
    assert master.slaves[7].state == 0, "its station address is gone"
    assert master.slaves[7].recover(1000) == 1
    assert master.slaves[7].reconfig(1000) == SAFE_OP


def test_outputs_that_stay_away_are_a_watchdog_error(bench: Bench) -> None:
    master = bench.operate()
    time.sleep(0.15)
    found = states(master)
    assert found[:DRIVES] == [(SAFE_OP | 0x10, 0x1B)] * DRIVES
    assert found[DRIVES:] == [(OP, 0)] * 2
    for slave in master.slaves[:DRIVES]:
        assert _drained_code(slave) == 0, "no drive was at work"


def _drained_code(slave: Any) -> int:
    drain(slave)
    return int(struct.unpack("<H", slave.sdo_read(0x603F, 0))[0])


def test_a_refused_state_is_named_with_its_code(bench: Bench) -> None:
    master = bench.init()
    bench.order(op="reject", slave=3, map={"4": 30})
    for slave in master.slaves[:DRIVES]:
        slave.config_func = lambda position: _map_drive(master.slaves[position])
    master.config_map()
    assert master.state_check(SAFE_OP, 50_000) != SAFE_OP
    found = states(master)
    assert found[3] == (PRE_OP | 0x10, 30)
    assert found[4] == (SAFE_OP, 0)


def test_another_identity_is_seen_at_bring_up(bench: Bench) -> None:
    inject(bench.directory, "wrong_identity", channel=bench.near, node=6, product=0x65520000)
    master = bench.init()
    assert [slave.id for slave in master.slaves[4:7]] == [0x65510000, 0x65520000, 0x65510000]


def test_an_abort_on_demand(bench: Bench) -> None:
    drive = bench.init().slaves[1]
    inject(
        bench.directory, "mailbox_abort", channel=bench.near, node=2, index=0x1018, code=0x06060000
    )
    with pytest.raises(pysoem.SdoError) as caught:
        drive.sdo_read(0x1018, 1)
    assert caught.value.abort_code == 0x06060000
    assert drive.sdo_read(0x1018, 1) == struct.pack("<I", 0xFB)


def test_lost_mailbox_answers_are_asked_for_again(bench: Bench) -> None:
    drive = bench.init().slaves[0]
    for order in ({"drop_mbx": 1}, {"drop_mbxw": 1}, {"drop_mbx": 1, "drop_mbxw": 1}):
        bench.order(op="fault", f=order)
        drive.sdo_write(0x210C, 2, struct.pack("<I", 77))
        bench.order(op="fault", f=order)
        assert drive.sdo_read(0x210C, 2) == struct.pack("<I", 77)


def test_an_error_of_the_drive_reaches_the_master(bench: Bench) -> None:
    master = bench.operate()
    heard: list[int] = []
    master.slaves[0].add_emergency_callback(lambda emergency: heard.append(emergency.error_code))
    bench.order(op="drive_fault", slave=0, code=34321)
    assert bench.until(
        lambda: struct.unpack_from("<H", master.slaves[0].input)[0] & 0x4F in (0x08, 0x0F)
    )
    assert bench.until(lambda: bool(drain(master.slaves[0])) or bool(heard))
    assert heard[0] == 34321
    assert _drained_code(master.slaves[0]) == 34321


# -- a ring ------------------------------------------------------------------------------------


def test_a_ring_that_is_cut_loses_nobody(tmp_path: Path) -> None:
    bench = Bench(tmp_path, ring=True)
    try:
        master = bench.operate()
        for reachable in (4, 9, DRIVES + 2):
            bench.order(op="cut", n=reachable)
            assert [bench.exchange() for _ in range(20)] == [EXPECTED] * 20
            assert states(master) == [(OP, 0)] * (DRIVES + 2)
    finally:
        bench.close()
