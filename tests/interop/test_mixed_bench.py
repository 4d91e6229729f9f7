"""A lab that emulates some nodes while others are somewhere else on the same bus."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import canopen
import pytest

from tonus.config import load
from tonus.sim.can.bridge import Bridge
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.server import serve

pytestmark = pytest.mark.realtime
TONUS = (sys.executable, "-m", "tonus.tools.cli")
EVERYONE_RESETS = can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x00")


def start(directory: Path, nodes: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [*TONUS, "lab", "config/can.yaml", "--nodes", nodes],
        env={**os.environ, "TONUS_RUNTIME_DIR": str(directory), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert "Ctrl-C" in process.stdout.readline()
    return process


def heard(bus: can.BusABC) -> list[int]:
    """Identifiers of what comes, until nothing does; a bus with one controller has only errors."""
    found = []
    for _ in range(100):
        message = bus.recv(0.5)
        if message is None:
            break
        if not message.is_error_frame:
            found.append(message.arbitration_id)
    return sorted(found)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Of a lab with a drive and a cell on can0, nothing on can1, and all of can2."""
    directory = tmp_path_factory.mktemp("lab")
    process = start(directory, "can0/1, can0/17,can2")
    yield directory
    process.terminate()
    process.wait(10)


def test_only_the_chosen_nodes_are_emulated(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(directory))
    for channel, expected in (
        ("can0", [0x701, 0x711]),
        ("can1", []),
        ("can2", [0x704, 0x706, 0x714, 0x716]),
        ("can3", []),
    ):
        with can.Bus(interface="tonus", channel=channel) as bus:
            bus.send(EVERYONE_RESETS)
            assert heard(bus) == expected


def test_a_node_of_another_process_joins_the_emulated_ones(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(directory))
    objects = canopen.ObjectDictionary()
    name = canopen.objectdictionary.ODVariable("name", 0x1008)
    name.data_type = canopen.objectdictionary.datatypes.VISIBLE_STRING
    objects.add_object(name)
    there, here = canopen.Network(), canopen.Network()
    there.connect(interface="tonus", channel="can0")
    here.connect(interface="tonus", channel="can0")
    try:
        there.create_node(7, objects).data_store.update({0x1008: {0: b"elsewhere"}})
        for node_id, expected in ((1, "EPOS4"), (7, "elsewhere"), (17, "force cell")):
            assert here.add_node(node_id, objects).sdo["name"].raw == expected
    finally:
        here.disconnect()
        there.disconnect()


def test_a_fault_of_a_node_that_is_elsewhere_is_refused(directory: Path) -> None:
    door = str(directory / "lab.sock")
    asked = subprocess.run(
        [*TONUS, "fault", "unplug", "--channel", "can0", "--node", "7", "--socket", door],
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert asked.returncode == 2
    assert asked.stderr.startswith("tonus: the lab refuses: there is no node 7 on channel 'can0'")
    assert asked.stderr.count("\n") == 1


@contextmanager
def bridged(directory: Path, interface: str) -> Iterator[None]:
    """A lab of this process, on a thread, whose channels are bridged to an interface."""
    config, scenario = load("config/can.yaml", overrides={"fieldbus.interface": interface})
    ready = threading.Event()
    loop = asyncio.new_event_loop()
    ended: list[BaseException] = []

    async def main() -> None:
        def clock() -> int:
            return int(loop.time() * 1e9)

        lab = Lab(config, scenario.lab, seed=1, clock=clock, start_ns=clock())
        await serve(lab, config, directory, ready.set)

    serving = loop.create_task(main())

    def run() -> None:
        try:
            loop.run_until_complete(serving)
        except (asyncio.CancelledError, LabError) as error:
            ended.append(error)
        finally:
            ready.set()
            loop.close()

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(30)
    if not ended:
        try:
            yield
        finally:
            loop.call_soon_threadsafe(serving.cancel)
    thread.join(30)
    assert not thread.is_alive()
    if isinstance(ended[0], LabError):
        raise ended[0]


def test_emulated_nodes_sit_on_a_bus_of_another_interface(tmp_path: Path) -> None:
    with can.Bus(interface="virtual", channel="can0") as bus:
        with bridged(tmp_path, "virtual"):
            assert heard(bus) == [0x701, 0x707, 0x711, 0x717]  # they boot
            network = canopen.Network(bus)
            network.notifier = can.Notifier(bus, network.listeners, 0.05)
            try:
                node = network.add_node(1, canopen.ObjectDictionary())
                assert node.sdo.upload(0x1008, 0) == b"EPOS4"
                # Segmented, so that frames go both ways many times.
                node.sdo.download(0x6071, 0, b"\x05\x00", force_segment=True)
                assert node.sdo.upload(0x6071, 0) == b"\x05\x00"
            finally:
                network.notifier.stop()
            assert not (tmp_path / "can0.sock").exists()
            assert (tmp_path / "lab.sock").exists()
            bus.send(can.Message(is_fd=True, arbitration_id=1, is_extended_id=False))
            bus.send(can.Message(is_error_frame=True))
            bus.send(EVERYONE_RESETS)
            assert len(heard(bus)) == 4
        bus.send(EVERYONE_RESETS)
        assert heard(bus) == []


def test_a_bus_that_fails_ends_the_lab_in_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other bus is that of a second lab, which has no nodes on can1 and goes away."""
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
    other = start(tmp_path, "can0")
    config, scenario = load("config/can.yaml")
    heard_there: list[int] = []
    failures: list[BaseException] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: failures.append(context["exception"]))

        def clock() -> int:
            return int(loop.time() * 1e9)

        lab = Lab(config, scenario.lab, seed=1, clock=clock, start_ns=clock())
        bridge = Bridge(lab, lab.channels["can1"], "tonus", 1_000_000, lambda: None)
        with can.Bus(interface="tonus", channel="can1") as bus:
            bus.send(EVERYONE_RESETS)
            for _ in range(50):
                await asyncio.sleep(0.01)
                lab.advance(clock())
                bridge.forward()
                while (message := bus.recv(0)) is not None:
                    heard_there.append(message.arbitration_id)
        other.terminate()
        other.wait(10)
        await asyncio.sleep(0.1)
        bridge.close()

    asyncio.run(main())
    assert {0x703, 0x705, 0x713, 0x715} <= set(heard_there)
    assert isinstance(failures[0], LabError)
    assert "channel can1 has failed" in str(failures[0])


def test_an_interface_that_is_not_there_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(LabError, match="nope channel can0 cannot be opened"):  # noqa: SIM117
        with bridged(tmp_path, "nope"):
            pass
    assert not (tmp_path / "lab.sock").exists()
