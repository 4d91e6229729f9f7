"""The SDO server's transfers, also those that go wrong or are cut short (CiA 301, 7.2.4)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from heapq import heappop, heappush

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lab_bench import Bench

from tonus.sim.can.canopen.sdo_server import SdoServer
from tonus.sim.devices.objects import Entry, Kind, ObjectDictionary

SECOND = 1_000_000_000
NAME = "a name of several segments"
TOGGLE, TIMEOUT, COMMAND = 0x05030000, 0x05040000, 0x05040001
LENGTH, SHORT = 0x06070010, 0x06070013


class Clock:
    """Timers that go off when a test says so."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._timers: list[tuple[int, int, Callable[[int], None]]] = []
        self._count = 0

    def call_at(self, at_ns: int, callback: Callable[[int], None]) -> None:
        self._count += 1
        heappush(self._timers, (at_ns, self._count, callback))

    def wait(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * SECOND)
        while self._timers and self._timers[0][0] <= end:
            self.now_ns, _, callback = heappop(self._timers)
            callback(self.now_ns)
        self.now_ns = end


class Client:
    """``sent``: what the server sent unasked."""

    def __init__(self) -> None:
        objects = ObjectDictionary()
        objects.add(0x1008, 0, Entry("Name", Kind.STRING, "const", NAME))
        objects.add(0x1009, 0, Entry("Nothing", Kind.STRING, "const", ""))
        objects.add(0x2000, 0, Entry("Word", Kind.U32, "rw", 7))
        objects.add(0x2001, 0, Entry("Long word", Kind.U64, "rw", 7))
        objects.add(0x2002, 0, Entry("Secret", Kind.U8, "wo", 0))
        self.objects = objects
        self.changed: list[int] = []
        self.sent: list[bytes] = []
        self.clock = Clock()
        self.server = SdoServer(objects, self.changed.append, self.clock, self.sent.append)

    def ask(self, command: int, index: int = 0, sub: int = 0, data: bytes = b"") -> bytes:
        request = struct.pack("<BHB", command, index, sub) + data.ljust(4, b"\0")
        answer = self.server.request(request)
        assert answer is not None
        assert len(answer) == 8
        return answer

    def segment(self, command: int, data: bytes = b"") -> bytes:
        answer = self.server.request(bytes((command,)) + data.ljust(7, b"\0"))
        assert answer is not None
        return answer

    def abort(self) -> None:
        assert self.server.request(struct.pack("<BHBI", 0x80, 0, 0, 0x08000000)) is None


def aborted(answer: bytes, code: int, index: int = 0x2001) -> bool:
    return answer == struct.pack("<BHBI", 0x80, index, 0, code)


def test_an_upload_in_segments_toggles_and_ends_with_the_unused_bytes() -> None:
    client = Client()
    first = client.ask(0x40, 0x1008)
    assert first == struct.pack("<BHBI", 0x41, 0x1008, 0, len(NAME))
    text, toggle = b"", 0
    while True:
        part = client.segment(0x60 | toggle << 4)
        assert part[0] >> 4 == toggle
        text += part[1 : 8 - (part[0] >> 1 & 7)]
        if part[0] & 1:
            break
        toggle ^= 1
    assert text.decode() == NAME
    assert aborted(client.segment(0x60), COMMAND, 0x1008), "there is nothing more"


def test_an_upload_of_nothing_is_one_empty_segment() -> None:
    client = Client()
    assert client.ask(0x40, 0x1009)[:1] == b"\x41"
    assert client.segment(0x60) == bytes((0x0F,)) + bytes(7)


@pytest.mark.parametrize("sized", [True, False])
def test_a_download_in_segments(sized: bool) -> None:
    client = Client()
    value = 0x1122334455667788
    data = value.to_bytes(8, "little")
    begin = client.ask(0x21 if sized else 0x20, 0x2001, 0, struct.pack("<I", 8 if sized else 0))
    assert begin == struct.pack("<BHB4x", 0x60, 0x2001, 0)
    assert client.segment(0x00, data[:7])[0] == 0x20
    assert client.objects.number(0x2001, 0) == 7, "nothing before the last"
    assert client.segment(0x10 | 6 << 1 | 1, data[7:])[0] == 0x30
    assert client.objects.number(0x2001, 0) == value
    assert client.changed == [0x2001]


def test_a_toggle_that_does_not_change_ends_the_transfer() -> None:
    client = Client()
    client.ask(0x21, 0x2001, 0, struct.pack("<I", 8))
    client.segment(0x00, bytes(7))
    assert aborted(client.segment(0x00, bytes(7)), TOGGLE)
    assert client.segment(0x10, bytes(7))[4:] == struct.pack("<I", COMMAND)
    client.ask(0x40, 0x1008)
    assert aborted(client.segment(0x70), TOGGLE, 0x1008)


@pytest.mark.parametrize(
    ("announced", "given_", "code"),
    [(8, 6, LENGTH), (4, 7, LENGTH), (None, 7, SHORT), (None, 9, LENGTH), (4, 4, SHORT)],
)
def test_a_length_that_does_not_fit(announced: int | None, given_: int, code: int) -> None:
    client = Client()
    size = b"" if announced is None else struct.pack("<I", announced)
    client.ask(0x20 if announced is None else 0x21, 0x2001, 0, size)
    data, toggle = bytes(given_), 0
    while len(data) > 7:
        client.segment(0x10 * toggle, data[:7])
        data, toggle = data[7:], 1 - toggle
    last = client.segment(toggle << 4 | (7 - len(data)) << 1 | 1, data)
    assert aborted(last, code)
    assert client.objects.number(0x2001, 0) == 7
    assert not client.changed


def test_more_than_any_object_holds_is_refused_early_and_late() -> None:
    client = Client()
    assert aborted(client.ask(0x21, 0x2001, 0, struct.pack("<I", 5000)), LENGTH)
    client.ask(0x20, 0x2001)
    for n in range(1000):
        answer = client.segment(0x10 * (n % 2), bytes(7))
        if answer[0] == 0x80:
            break
    assert aborted(answer, LENGTH)


def test_a_clients_abort_is_obeyed_in_silence() -> None:
    client = Client()
    client.ask(0x21, 0x2001, 0, struct.pack("<I", 8))
    client.abort()
    assert client.segment(0x00, bytes(7))[4:] == struct.pack("<I", COMMAND)


def test_a_new_transfer_takes_the_place_of_the_old() -> None:
    client = Client()
    client.ask(0x21, 0x2001, 0, struct.pack("<I", 8))
    client.segment(0x00, bytes(7))
    client.ask(0x40, 0x1008)
    assert client.segment(0x60)[1:] == NAME[:7].encode()
    assert client.ask(0x23, 0x2000, 0, struct.pack("<I", 9))[0] == 0x60
    assert client.objects.number(0x2000, 0) == 9
    assert client.objects.number(0x2001, 0) == 7


def test_a_client_that_falls_silent_is_told_so() -> None:
    client = Client()
    client.ask(0x40, 0x1008)
    client.clock.wait(0.9)
    client.segment(0x60)
    client.clock.wait(0.9)
    assert not client.sent
    client.clock.wait(0.2)
    assert [aborted(frame, TIMEOUT, 0x1008) for frame in client.sent] == [True]
    client.ask(0x23, 0x2000, 0, struct.pack("<I", 9))
    client.clock.wait(5.0)
    assert len(client.sent) == 1, "an expedited transfer is over at once"


@pytest.mark.parametrize("command", [0xA0, 0xA4, 0xC2, 0xC6, 0xE0])
def test_block_transfer_is_an_unknown_command(command: int) -> None:
    assert aborted(Client().ask(command, 0x2001), COMMAND)


def test_access_is_refused_before_any_segment() -> None:
    client = Client()
    assert aborted(client.ask(0x21, 0x1008, 0, struct.pack("<I", 30)), 0x06010002, 0x1008)
    assert aborted(client.ask(0x40, 0x2002), 0x06010001, 0x2002)
    assert aborted(client.ask(0x21, 0x3000, 0, struct.pack("<I", 8)), 0x06020000, 0x3000)


@pytest.mark.parametrize(("command", "taken"), [(0x22, True), (0x23, True), (0x27, False)])
def test_an_expedited_download_may_leave_its_length_open(command: int, taken: bool) -> None:
    client = Client()
    answer = client.ask(command, 0x2000, 0, struct.pack("<I", 9))
    assert (answer[0] == 0x60) is taken
    assert client.objects.number(0x2000, 0) == (9 if taken else 7)


requests = st.one_of(
    st.binary(min_size=8, max_size=8),
    st.builds(
        lambda command, index, data: struct.pack("<BHB", command, index, 0) + data,
        st.sampled_from([0x20, 0x21, 0x22, 0x23, 0x2F, 0x40, 0xA0, 0xC2]),
        st.sampled_from([0x1008, 0x1009, 0x2000, 0x2001, 0x2002]),
        st.binary(min_size=4, max_size=4),
    ),
    st.builds(
        lambda command, data: bytes((command,)) + data,
        st.sampled_from([0x00, 0x10, 0x01, 0x11, 0x0D, 0x1D, 0x60, 0x70, 0x80]),
        st.binary(min_size=7, max_size=7),
    ),
)


@given(st.lists(st.tuples(requests, st.sampled_from([0.0, 0.0, 0.5, 2.0])), max_size=40))
@settings(max_examples=100, derandomize=True, deadline=None)
def test_after_any_requests_the_server_serves(sequence: list[tuple[bytes, float]]) -> None:
    client = Client()
    for request, seconds in sequence:
        answer = client.server.request(request)
        assert (answer is None) is (request[0] >> 5 == 4)
        client.clock.wait(seconds)
    assert client.ask(0x23, 0x2000, 0, struct.pack("<I", 42))[0] == 0x60
    assert client.ask(0x40, 0x2000)[4:] == struct.pack("<I", 42)


def test_a_node_of_the_lab_tells_a_silent_client_on_its_bus() -> None:
    with Bench() as bench:
        assert bench.request("can0", 1, struct.pack("<BHB4x", 0x40, 0x1008, 0))[0] == 0x41
        bench.wait(1500)
        frames = [bytes(m.data) for m in bench.read("can0") if m.arbitration_id == 0x581]
        assert frames == [struct.pack("<BHBI", 0x80, 0x1008, 0, TIMEOUT)]


def test_pdo_parameters_are_refused_in_the_wrong_nmt_state() -> None:
    with Bench() as bench:
        bench.send("can0", 0x000, b"\x01\x01")
        bench.wait(1)
        assert bench.write("can0", 1, 0x1400, 2, 1, 1) == 0x0F00FFC0
        assert bench.write("can0", 1, 0x1800, 3, 20, 2) == 0, "but for the inhibit time"
