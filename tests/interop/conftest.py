"""Fixtures of a lab in its own process, and of python-canopen joined to it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import canopen
import pytest
import running_lab
from canopen_client import Drive, Networks


@pytest.fixture(scope="session")
def lab_directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of a running lab's sockets; one lab for all, and who uses a node resets it first."""
    directory = tmp_path_factory.mktemp("lab")
    process = running_lab.start(directory)
    yield directory
    process.terminate()
    process.wait(10)


@pytest.fixture(scope="module")
def lab(lab_directory: Path) -> Iterator[Path]:
    """The running lab, which every bus of this process now finds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TONUS_RUNTIME_DIR", str(lab_directory))
        yield lab_directory


@pytest.fixture(scope="module")
def networks(lab: Path) -> Iterator[Networks]:
    """python-canopen on all four channels."""
    joined = {name: canopen.Network() for name in running_lab.DRIVES}
    for name, network in joined.items():
        network.NOTIFIER_CYCLE = 0.05
        network.connect(interface="tonus", channel=name)
    yield joined
    for network in joined.values():
        network.sync.stop()
        network.disconnect()


@pytest.fixture
def drive(networks: Networks) -> Iterator[Drive]:
    """Drive 1, reset just now."""
    made = Drive(networks["can0"], 1)
    made.reset()
    yield made
    made.leave()
