"""python-canopen's CiA 402 profile drives an emulated drive that was made from the same EDS."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from canopen_client import CST, PATIENCE_S, eventually
from door_client import inject
from running_lab import environment

import tonus.config

pytestmark = pytest.mark.realtime

EDS = Path(tonus.config.__path__[0]) / "drives" / "cia402.eds"
COMMAND = (sys.executable, "-m", "tonus.tools.cli", "lab", "config/mixed_drives.yaml")
CHANNEL, NODE = "can1", 3


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A lab of mixed drives in a process of its own."""
    directory = tmp_path_factory.mktemp("mixed")
    process = subprocess.Popen(
        COMMAND, env=environment(directory), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert str(directory) in process.stdout.readline()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TONUS_RUNTIME_DIR", str(directory))
        yield directory
    process.terminate()
    process.wait(10)


@pytest.fixture
def drive(lab: Path) -> Iterator[BaseNode402]:
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="tonus", channel=CHANNEL)
    node = BaseNode402(NODE, str(EDS))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    yield node
    network.disconnect()


def test_it_is_configured_enabled_moved_faulted_and_reset(drive: BaseNode402, lab: Path) -> None:
    drive.nmt.send_command(0x80)
    drive.tpdo.read()
    drive.rpdo.read()
    assert [found.index for found in drive.tpdo[1].map] == [0x6041, 0x6064, 0x6077]
    for pdo in (drive.rpdo[1], drive.tpdo[1]):
        pdo.trans_type = 1
        pdo.save()
    drive.sdo[0x1017].raw = 50
    drive.op_mode = CST
    assert drive.sdo[0x6061].raw == 10
    drive.setup_402_state_machine(read_pdos=False)
    drive.network.sync.start(0.01)
    drive.rpdo[1].start(0.01)
    drive.nmt.state = "OPERATIONAL"
    assert drive.nmt.wait_for_heartbeat(PATIENCE_S) == "OPERATIONAL"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        drive.state = state
        assert eventually(lambda state=state: drive.state == state)  # type: ignore[misc]
    before = drive.sdo[0x6064].raw
    drive.rpdo[1][0x6071].raw = 100
    assert eventually(lambda: abs(drive.sdo[0x6064].raw - before) > 50)
    drive.rpdo[1][0x6071].raw = 0
    inject(lab, "drive_error", channel=CHANNEL, node=NODE, code=0x7305)
    assert eventually(lambda: drive.state == "FAULT")
    assert drive.sdo[0x603F].raw == 0x7305
    drive.reset_from_fault()
    assert eventually(lambda: drive.state == "OPERATION ENABLED")  # it goes on to there by itself
    assert drive.sdo[0x603F].raw == 0
    drive.rpdo[1].stop()
    drive.network.sync.stop()
    drive.nmt.send_command(0x81)


def test_every_object_of_the_sheet_is_there(drive: BaseNode402) -> None:
    drive.nmt.send_command(0x80)
    read = 0
    for variable in drive.object_dictionary.values():
        parts = [variable] if not hasattr(variable, "values") else list(variable.values())
        for part in parts:
            if "r" in part.access_type or part.access_type == "const":
                assert len(drive.sdo.upload(part.index, part.subindex)) > 0
                read += 1
    assert read > 80
