"""A lab in its own process, used by python-canopen and python-can's own logger."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

from sim.can.plugin import TonusBus

pytestmark = pytest.mark.realtime

SERVE = """
import asyncio, sys
from pathlib import Path
from config import load
from sim.lab import Lab
from sim.server import serve

async def main():
    loop = asyncio.get_running_loop()
    clock = lambda: int(loop.time() * 1e9)
    config, scenario = load("config/can.yaml")
    lab = Lab(config, scenario.lab, seed=1, clock=clock, start_ns=clock())
    await serve(lab, config, Path(sys.argv[1]), lambda: print("ready", flush=True))

try:
    asyncio.run(main())
except Exception as error:
    print(type(error).__name__, error, flush=True)
    sys.exit(1)
"""


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lab")


def start(directory: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SERVE, str(directory)], stdout=subprocess.PIPE, text=True
    )


@pytest.fixture(scope="module")
def lab(directory: Path) -> Iterator[Path]:
    process = start(directory)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    yield directory
    process.terminate()
    process.wait(10)


@pytest.fixture
def network(lab: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[canopen.Network]:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(lab))
    network = canopen.Network()
    network.connect(interface="tonus", channel="can0")
    yield network
    network.disconnect()


def dictionary() -> canopen.ObjectDictionary:
    """What this test uses of a drive, typed by hand."""
    types = canopen.objectdictionary.datatypes
    objects = canopen.ObjectDictionary()
    for index, name, kind in (
        (0x1008, "name", types.VISIBLE_STRING),
        (0x6040, "controlword", types.UNSIGNED16),
        (0x6041, "statusword", types.UNSIGNED16),
        (0x6060, "mode", types.INTEGER8),
        (0x6061, "mode shown", types.INTEGER8),
        (0x6064, "position", types.INTEGER32),
        (0x6071, "torque", types.INTEGER16),
        (0x6502, "modes", types.UNSIGNED32),
    ):
        variable = canopen.objectdictionary.ODVariable(name, index)
        variable.data_type = kind
        variable.pdo_mappable = True
        objects.add_object(variable)
    for index, entries in (
        (0x1400, (types.UNSIGNED32, types.UNSIGNED8)),
        (0x1800, (types.UNSIGNED32, types.UNSIGNED8, types.UNSIGNED16)),
        (0x1600, (types.UNSIGNED32,) * 8),
        (0x1A00, (types.UNSIGNED32,) * 8),
    ):
        record = canopen.objectdictionary.ODRecord(f"pdo {index:x}", index)
        for sub, kind in enumerate((types.UNSIGNED8, *entries)):
            variable = canopen.objectdictionary.ODVariable(f"sub {sub}", index, sub)
            variable.data_type = kind
            record.add_member(variable)
        objects.add_object(record)
    return objects


def test_objects_are_read_and_refused(network: canopen.Network) -> None:
    node = network.add_node(1, dictionary())
    assert node.sdo["name"].raw == "EPOS4"
    assert node.sdo["modes"].raw == 0x3A5
    assert int.from_bytes(node.sdo.upload(0x1018, 2), "little") == 0x65510000
    with pytest.raises(SdoAbortedError) as refused:
        node.sdo.upload(0x4711, 0)
    assert refused.value.code == 0x06020000
    with pytest.raises(SdoAbortedError) as refused:
        node.sdo.download(0x60C2, 1, b"\xff")
    assert refused.value.code == 0x06090030
    # Segmented, both ways; an integer's length is checked there as well.
    node.sdo.download(0x6071, 0, b"\x05\x00", force_segment=True)
    assert node.sdo["torque"].raw == 5
    with pytest.raises(SdoAbortedError) as refused:
        node.sdo.download(0x6071, 0, bytes(20))
    assert refused.value.code == 0x06070010


def test_a_node_boots_and_beats(network: canopen.Network) -> None:
    node = network.add_node(17, canopen.ObjectDictionary())
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(5)
    node.sdo.download(0x1017, 0, (20).to_bytes(2, "little"))
    node.nmt.state = "OPERATIONAL"
    deadline = 50
    while node.nmt.wait_for_heartbeat(5) != "OPERATIONAL":
        deadline -= 1
        assert deadline > 0
    node.nmt.state = "RESET COMMUNICATION"
    node.nmt.wait_for_bootup(5)


def test_a_402_client_brings_a_drive_to_operation_enabled(network: canopen.Network) -> None:
    node = BaseNode402(2, dictionary())
    network.add_node(node)
    node.sdo["mode"].raw = 10
    assert node.sdo["mode shown"].raw == 10
    node.tpdo[1].read()
    node.rpdo[1].read()
    assert node.tpdo[1].cob_id == 0x182
    tpdo, rpdo = node.tpdo[1], node.rpdo[1]
    tpdo.clear()
    tpdo.add_variable(0x6041)
    tpdo.add_variable(0x6064)
    tpdo.trans_type = 255
    tpdo.enabled = True
    tpdo.save()
    rpdo.clear()
    rpdo.add_variable(0x6040)
    rpdo.add_variable(0x6071)
    rpdo.trans_type = 255
    rpdo.enabled = True
    rpdo.save()
    node.setup_pdos(upload=False)
    node.nmt.state = "OPERATIONAL"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
        assert node.state == state
    node.state = "SWITCH ON DISABLED"
    assert node.sdo["statusword"].raw & 0x6F == 0x40


def test_python_cans_logger_joins(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = {**os.environ, "TONUS_RUNTIME_DIR": str(lab), "PYTHONUNBUFFERED": "1"}
    log = tmp_path / "out.asc"
    logger = subprocess.Popen(
        [sys.executable, "-m", "can.logger", "-i", "tonus", "-c", "can1", "-f", str(log)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert logger.stdout is not None
    assert "tonus" in logger.stdout.readline().lower()  # it is connected
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(lab))
    bus = TonusBus("can1")
    for _ in range(20):
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x03"))
        answer = bus.recv(5)
        assert answer is not None
        assert answer.arbitration_id == 0x703
    bus.shutdown()
    logger.send_signal(signal.SIGINT)
    logger.wait(10)
    assert " 703 " in log.read_text()


def test_python_cans_viewer_shows_a_node(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(lab))
    bus = TonusBus("can3")
    screen, terminal = pty.openpty()
    viewer = subprocess.Popen(
        [sys.executable, "-m", "can.viewer", "-i", "tonus", "-c", "can3"],
        env={**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "100"},
        stdin=terminal,
        stdout=terminal,
    )
    shown = b""
    for _ in range(200):
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x07"))
        if select.select([screen], [], [], 0.1)[0]:
            shown += os.read(screen, 65536)
        if b"0x707" in shown:
            break
    viewer.terminate()
    viewer.wait(10)
    bus.shutdown()
    os.close(screen)
    os.close(terminal)
    assert b"0x707" in shown


def test_who_reads_by_file_descriptor_misses_nothing(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(lab))
    bus = TonusBus("can2")
    notifier_seen: list[can.Message] = []
    notifier = can.Notifier(bus, [notifier_seen.append], timeout=0.05)
    done = can.BufferedReader()
    notifier.add_listener(done)
    bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x00"))
    for _ in range(4):
        assert done.get_message(5) is not None
    notifier.stop()
    bus.shutdown()
    assert sorted(m.arbitration_id for m in notifier_seen) == [0x705, 0x706, 0x715, 0x716]
    stamps = [m.timestamp for m in notifier_seen]
    assert stamps == sorted(stamps)


def test_a_second_lab_does_not_take_the_sockets(lab: Path) -> None:
    second = subprocess.run(
        [sys.executable, "-c", SERVE, str(lab)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert second.returncode == 1
    assert "already runs" in second.stdout


def test_stale_sockets_are_removed_and_ones_own_go_with_the_lab(tmp_path: Path) -> None:
    first = start(tmp_path)
    assert first.stdout is not None
    assert first.stdout.readline() == "ready\n"
    first.kill()
    first.wait(10)
    assert (tmp_path / "can0.sock").exists()
    second = start(tmp_path)
    assert second.stdout is not None
    assert second.stdout.readline() == "ready\n"
    second.send_signal(signal.SIGINT)
    second.wait(10)
    assert not list(tmp_path.glob("*.sock"))


def test_without_a_lab_there_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(can.CanInitializationError, match="no lab answers at"):
        can.Bus(interface="tonus", channel="can0")
