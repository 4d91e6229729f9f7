"""A lab in its own process: its sockets, and python-can's own tools on them."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time  # noqa: TID251 - another process keeps this lab's time
from contextlib import suppress
from pathlib import Path

import can
import pytest
from running_lab import COMMAND, environment, start

from tonus.config.loader import HERE
from tonus.sim.can.plugin import TonusBus
from tonus.sim.can.wire.timing import frame_bits

pytestmark = pytest.mark.realtime


def test_python_cans_logger_joins(lab: Path) -> None:
    # In a background job it is ignored, and so would the logger that it ends below.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    logger = subprocess.Popen(
        [sys.executable, "-m", "can.logger", "-i", "tonus", "-c", "can1"],
        env=environment(lab),
        stdout=subprocess.PIPE,
        text=True,
    )
    signal.signal(signal.SIGINT, before)
    assert logger.stdout is not None
    assert "tonus" in logger.stdout.readline().lower()  # it is connected
    assert "Started" in logger.stdout.readline()
    bus = TonusBus("can1")
    for _ in range(20):
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x03"))
        answer = bus.recv(5)
        assert answer is not None
        assert answer.arbitration_id == 0x703
    bus.shutdown()
    lines = [logger.stdout.readline() for _ in range(40)]
    for _ in range(3):  # Python drops a KeyboardInterrupt that meets it in a destructor
        logger.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            logger.wait(5)
            break
    assert logger.returncode == 0
    assert sum(" 703 " in line for line in lines) == 20
    assert sum(" 000 " in line for line in lines) == 20


def test_what_a_client_has_sent_stays_sent_when_it_leaves(lab: Path) -> None:
    """As on any interface: a script may send and end."""
    listener = TonusBus("can2")
    for number in range(10):
        bus = TonusBus("can2")
        sent = [bytes([number, each]) for each in range(16)]
        for data in sent:
            bus.send(can.Message(arbitration_id=0x7A0, is_extended_id=False, data=data))
        bus.shutdown()
        heard: list[bytes] = []
        while len(heard) < len(sent) and (message := listener.recv(2)) is not None:
            if message.arbitration_id == 0x7A0:
                heard.append(bytes(message.data))
        assert heard == sent
    listener.shutdown()


def test_a_listener_sees_the_boot_ups_that_commissioning_shows(lab: Path) -> None:
    """The lab's nodes have said their names before anybody can listen; the page has them reset, by
    a command that does not leave before its frame is on the bus."""
    page = (HERE.parent / "docs/commissioning.md").read_text(encoding="utf-8")
    told = page.partition("\n## 3. ")[2].partition("\n## ")[0]
    (command,) = re.findall(r"`python -c '([^']+)'`", told)
    shown = [int(each, 16) for each in re.findall(r"ID: +([0-9a-f]+) ", told)]
    assert len(shown) == 4
    listener = TonusBus("can0")
    for _ in range(5):
        done = subprocess.run(
            [sys.executable, "-c", command],
            env=environment(lab),
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        heard: list[int] = []
        while len(heard) < len(shown) and (message := listener.recv(2)) is not None:
            if bytes(message.data) == b"\0":
                heard.append(message.arbitration_id)
        assert heard == shown
    listener.shutdown()


def test_python_cans_viewer_shows_a_node(lab: Path) -> None:
    bus = TonusBus("can3")
    screen, terminal = pty.openpty()
    viewer = subprocess.Popen(
        [sys.executable, "-m", "can.viewer", "-i", "tonus", "-c", "can3"],
        env={**environment(lab), "TERM": "xterm", "LINES": "24", "COLUMNS": "100"},
        stdin=terminal,
        stdout=terminal,
    )
    shown = b""
    for _ in range(200):
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x08"))
        if select.select([screen], [], [], 0.1)[0]:
            shown += os.read(screen, 65536)
        if b"0x708" in shown:
            break
    viewer.terminate()
    viewer.wait(10)
    bus.shutdown()
    os.close(screen)
    os.close(terminal)
    assert b"0x708" in shown


def test_who_reads_by_file_descriptor_misses_nothing(lab: Path) -> None:
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
    assert sorted(m.arbitration_id for m in notifier_seen) == [0x704, 0x706, 0x714, 0x716]
    stamps = [m.timestamp for m in notifier_seen]
    assert stamps == sorted(stamps)


def test_a_frame_is_on_the_wire_from_the_time_it_was_sent(lab: Path) -> None:
    """However late the lab's process reads it, unless the lab had moved on already."""
    bus, listener = TonusBus("can2"), TonusBus("can2")
    length, delays = frame_bits(0x555, 0, b"") * 1e-6, []
    for _ in range(20):
        sent = time.monotonic()
        bus.send(can.Message(arbitration_id=0x555, is_extended_id=False, timestamp=sent))
        heard = listener.recv(5)
        assert heard is not None
        delays.append(heard.timestamp - sent)
    assert min(delays) > 0.0
    assert sum(delay == pytest.approx(length, abs=1e-6) for delay in delays) > 10
    bus.shutdown()
    listener.shutdown()


def test_who_looks_seldom_gets_the_same_frames_in_fewer_packets(lab: Path) -> None:
    sender, at_once, seldom = TonusBus("can2"), TonusBus("can2"), TonusBus("can2", gather_ms=250)
    began = time.monotonic()
    heard: list[can.Message] = []
    for number in range(1, 6):
        sender.send(can.Message(arbitration_id=number, is_extended_id=False))
        message = at_once.recv(5)
        assert message is not None
        heard.append(message)
    took = time.monotonic() - began
    first = seldom.recv(5)
    waiting = len(seldom.receive_frames(10))
    assert waiting == 0 or took > 0.2  # the rest comes later, unless this host was that slow
    later = [first] + [seldom.recv(5) for _ in range(4 - waiting)]
    assert [each.arbitration_id for each in heard] == [1, 2, 3, 4, 5]
    stamps = {each.arbitration_id: each.timestamp for each in heard}
    assert all(each is not None and each.timestamp == stamps[each.arbitration_id] for each in later)
    for bus in (sender, at_once, seldom):
        bus.shutdown()
    with pytest.raises(can.CanInitializationError, match="gather_ms is 256"):
        TonusBus("can2", gather_ms=256)


def test_who_joined_before_a_frame_was_sent_hears_it(tmp_path: Path) -> None:
    """However late the lab's process gets to hear of either."""
    lab = start(tmp_path)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
            known = TonusBus("can2")
            for number in range(6):
                lab.send_signal(signal.SIGSTOP)
                joined = [TonusBus("can2") for _ in range(3)]
                sender = (known, *joined)[number % 2]
                sender.send(can.Message(arbitration_id=1, is_extended_id=False))
                lab.send_signal(signal.SIGCONT)
                assert all(bus.recv(5) for bus in (known, *joined) if bus is not sender)
                for bus in joined:
                    bus.shutdown()
            known.shutdown()
    finally:
        lab.terminate()
        lab.wait(10)


def test_a_second_lab_does_not_take_the_sockets(lab: Path) -> None:
    second = subprocess.run(
        COMMAND, env=environment(lab), capture_output=True, text=True, timeout=30, check=False
    )
    assert second.returncode == 2
    assert "already runs" in second.stderr
    assert second.stderr.count("\n") == 1


def test_stale_sockets_are_removed_and_ones_own_go_with_the_lab(tmp_path: Path) -> None:
    first = start(tmp_path)
    first.kill()
    first.wait(10)
    assert (tmp_path / "can0.sock").exists()
    second = start(tmp_path)
    second.send_signal(signal.SIGINT)
    second.wait(10)
    assert not list(tmp_path.glob("*.sock"))


def test_without_a_lab_there_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(can.CanInitializationError, match="no lab answers at"):
        can.Bus(interface="tonus", channel="can0")
