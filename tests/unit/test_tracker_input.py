"""Poses from datagrams: the newest counts, the rest is passed over or told."""

from __future__ import annotations

import errno
import socket
import struct

import pytest

from tonus.drivers.devices.tracker import TrackerInput, UdpTracker
from tonus.drivers.errors import DriverError
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import ProcessImage

MS = 1_000_000


def datagram(sequence: int, timestamp_ns: int, x: float = 0.0, **fields: object) -> bytes:
    values = {
        "magic": b"TNTK",
        "version": 1,
        "body": 0,
        "flags": 1,
        "quaternion": (1.0, 0.0, 0.0, 0.0),
    } | fields
    return struct.pack(
        "<4sHHIIq3d4df",
        values["magic"],
        values["version"],
        values["body"],
        sequence,
        values["flags"],
        timestamp_ns,
        *(x, 0.25, -0.5),
        *values["quaternion"],
        1e-4,
    )


class Listed:
    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        self.closed = False

    def poll(self, now_ns: int) -> list[bytes]:
        taken, self.waiting = self.waiting, []
        return taken

    def close(self) -> None:
        self.closed = True


def setup() -> tuple[ProcessImage, Listed, TrackerInput]:
    image, source = ProcessImage(8), Listed()
    return image, source, TrackerInput(image, source)


def test_a_pose_is_fresh_in_one_tick_and_then_only_ages() -> None:
    image, source, tracker = setup()
    source.waiting = [datagram(7, 3 * MS, 0.125)]
    tracker.collect(10 * MS)
    row = image.tracker
    assert row["position"].tolist() == [0.125, 0.25, -0.5]
    assert (row["sequence"], row["fresh"]) == (7, 1)
    assert row["delay"] == pytest.approx(0.007)
    tracker.collect(11 * MS)
    assert row["fresh"] == 0
    assert row["delay"] == pytest.approx(0.008)
    assert row["position"][0] == 0.125


def test_the_newest_pose_wins_and_older_ones_never_come_back() -> None:
    image, source, tracker = setup()
    source.waiting = [datagram(1, 1 * MS), datagram(3, 3 * MS), datagram(2, 2 * MS)]
    tracker.collect(5 * MS)
    assert image.tracker["sequence"] == 3
    source.waiting = [datagram(2, 2 * MS), datagram(3, 3 * MS)]
    tracker.collect(6 * MS)
    assert (image.tracker["sequence"], image.tracker["fresh"]) == (3, 0)


def test_a_pose_that_is_not_valid_or_not_ours_is_passed_over_in_silence() -> None:
    image, source, tracker = setup()
    source.waiting = [datagram(1, MS, flags=0), datagram(2, MS, body=1)]
    tracker.collect(5 * MS)
    assert image.tracker["fresh"] == 0
    assert tracker.malformed == 0
    assert tracker.take_events() == []


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (b"", "0 bytes"),
        (datagram(1, MS)[:-1], "83 bytes"),
        (datagram(1, MS) + b"\0", "85 bytes"),
        (datagram(1, MS, magic=b"ABCD"), "TNTK"),
        (datagram(1, MS, version=2), "version 2"),
        (datagram(1, MS, x=float("nan")), "not finite"),
        (datagram(1, MS, quaternion=(0.0, 0.0, 0.0, 0.0)), "norm 0"),
        (datagram(1, 6 * MS), "future"),
    ],
)
def test_a_datagram_that_cannot_be_believed_is_counted_and_told(bad: bytes, why: str) -> None:
    image, source, tracker = setup()
    before = image.tracker.tobytes()
    for tick in range(100):
        source.waiting = [bad]
        tracker.collect(5 * MS)
        if tick == 0:
            (event,) = tracker.take_events()
            assert event.name == "tracker_malformed"
            assert why in event.text
    assert image.tracker.tobytes() == before
    assert tracker.malformed == 100
    assert len(tracker.take_events()) == 6


class Failing(Listed):
    def poll(self, now_ns: int) -> list[bytes]:
        raise OSError(errno.ENETDOWN, "Network is down")


def test_an_error_of_the_socket_is_counted_and_ends_no_tick() -> None:
    image, source = ProcessImage(8), Failing()
    tracker = TrackerInput(image, source)
    for _ in range(100):
        tracker.collect(5 * MS)
    assert tracker.failures == 100
    events = tracker.take_events()
    assert {event.name for event in events} == {"tracker_receive_failure"}
    assert len(events) == 7
    assert events[0].text.startswith("cannot receive: Network is down; ")
    assert image.tracker["fresh"] == 0


class BrokenSocket:
    def __init__(self) -> None:
        self.answers: list[bytes | OSError] = []

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        answer = self.answers.pop(0) if self.answers else BlockingIOError(errno.EAGAIN, "none")
        if isinstance(answer, OSError):
            raise answer
        return answer, ("127.0.0.1", 4711)

    def close(self) -> None:
        pass


def test_what_came_before_an_error_of_the_socket_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    source = UdpTracker("127.0.0.1", 0, 100.0)
    source.close()
    broken = BrokenSocket()
    monkeypatch.setattr(source, "_socket", broken)
    image = ProcessImage(8)
    tracker = TrackerInput(image, source)
    broken.answers = [datagram(1, MS), OSError(errno.ECONNREFUSED, "refused"), datagram(2, 2 * MS)]
    tracker.collect(5 * MS)
    assert (image.tracker["sequence"], tracker.failures) == (1, 0)
    tracker.collect(6 * MS)
    assert (image.tracker["fresh"], tracker.failures) == (0, 1)
    tracker.collect(7 * MS)
    assert (image.tracker["sequence"], tracker.failures) == (2, 1)


def test_the_socket_gives_what_has_arrived_and_never_waits() -> None:
    tracker = UdpTracker("127.0.0.1", 0, 100.0)
    try:
        assert tracker.poll(0) == []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for sequence in range(3):
                sender.sendto(datagram(sequence, MS), ("127.0.0.1", tracker.port))
        assert len(tracker.poll(0)) == 3
        with pytest.raises(DriverError, match="tracker port"):
            UdpTracker("127.0.0.1", tracker.port, 100.0)
    finally:
        tracker.close()


def test_a_second_sender_is_named_and_not_used_while_the_first_is_heard() -> None:
    events = EventLog()
    source = UdpTracker("127.0.0.1", 0, 100.0, events)
    image = ProcessImage(8)
    tracker = TrackerInput(image, source, events)
    ours, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    used = image.tracker["sequence"]
    try:
        to = ("127.0.0.1", source.port)
        for number in range(1, 5):
            ours.sendto(datagram(number, number * MS), to)
            other.sendto(datagram(11, number * MS + 1), to)
            tracker.collect(10 * MS * number)
            assert used == number
        told = tracker.take_events()
        assert [event.name for event in told] == ["tracker_second_sender"] * 3
        address = f"127.0.0.1:{other.getsockname()[1]}"
        assert told[0].text.startswith(
            f"{address} sends poses too; 127.0.0.1:{ours.getsockname()[1]}"
        )
        # The first was heard at 40 ms.
        for now_ms, sequence in ((140, 4), (141, 12)):
            other.sendto(datagram(12, now_ms * MS), to)
            tracker.collect(now_ms * MS)
            assert used == sequence
        ours.sendto(datagram(5, 142 * MS), to)
        tracker.collect(142 * MS)
        assert used == 12, "it is the second one now"
    finally:
        for each in (ours, other, tracker):
            each.close()
