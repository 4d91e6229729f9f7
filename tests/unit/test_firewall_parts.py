"""A part behind the firewall by itself: what is counted, reported and switched off."""

from __future__ import annotations

import pytest

from tonus.runtime.safety.firewall import Firewall, Part, in_one_line

LIMIT = 3


def bad(text: str = "no disk") -> None:
    raise OSError(text)


def good(value: int, *, twice: bool = False) -> int:
    return 2 * value if twice else value


def names(part: Part) -> list[str]:
    return [event.name for event in part.take_events()]


def test_a_part_that_works_gives_what_it_gives() -> None:
    part = Part("record", LIMIT)
    assert part.call(good, 4) == 4
    assert part.call(lambda: good(4, twice=True)) == 8
    assert (part.failures, part.failing, part.off, part.first) == (0, False, False, None)
    assert part.take_events() == []


def test_a_failure_is_counted_and_reported_and_gives_nothing() -> None:
    part = Part("record", LIMIT)
    assert part.call(bad) is None
    (event,) = part.take_events()
    assert (event.name, event.where) == ("part_failed", "record")
    assert event.text == "OSError: no disk; failure 1, control goes on without it"
    assert part.take_events() == [], "they are taken once"
    assert (part.failures, part.failing, part.off) == (1, False, False)
    assert isinstance(part.first, OSError)


def test_so_many_failures_in_a_row_switch_it_off() -> None:
    part = Part("record", LIMIT)
    for _ in range(LIMIT - 1):
        part.call(bad)
        assert not part.off
        assert not part.failing
    part.take_events()
    part.call(bad)
    assert part.off
    assert part.failing
    (event,) = part.take_events()
    assert (event.name, event.where) == ("part_off", "record")
    assert event.text == "switched off after 3 failures in a row: OSError: no disk"
    assert part.call(good, 4) is None, "it is not called again"
    assert part.failures == LIMIT


def test_a_success_begins_the_count_anew() -> None:
    part = Part("record", LIMIT)
    for _ in range(10):
        for _ in range(LIMIT - 1):
            part.call(bad)
        assert part.call(good, 4) == 4
    assert not part.off
    assert not part.failing
    assert part.failures == 10 * (LIMIT - 1)
    for _ in range(LIMIT):
        part.call(bad)
    assert part.off


def test_a_lasting_part_is_called_however_often_it_fails() -> None:
    part = Part("fallback", LIMIT, lasting=True)
    for _ in range(LIMIT + 1):
        part.call(bad)
    assert part.failing
    assert not part.off
    assert part.call(good, 4) == 4
    assert "part_off" not in names(part)


def test_ever_fewer_failures_are_reported() -> None:
    part = Part("fallback", LIMIT, lasting=True)
    told = []
    for count in range(1, 20):
        part.call(bad)
        told += [count] * len(names(part))
    assert told == [1, 2, 4, 8, 16]


def test_the_first_error_is_kept() -> None:
    part = Part("fallback", LIMIT, lasting=True)
    part.call(bad, "one")
    part.call(bad, "two")
    assert str(part.first) == "one"


def test_a_firewall_has_the_events_and_tracebacks_of_its_parts() -> None:
    firewall = Firewall(LIMIT)
    parts = [firewall.part("one"), firewall.part("two"), firewall.part("three", lasting=True)]
    assert (firewall.take_events(), firewall.tracebacks()) == ([], "")
    for part in (parts[0], parts[2]):
        for _ in range(LIMIT):
            part.call(bad)
    assert [part.off for part in parts] == [True, False, False]
    assert [event.where for event in firewall.take_events()] == ["one"] * 3 + ["three"] * 2
    assert firewall.take_events() == []
    text = firewall.tracebacks()
    assert text.startswith("one failed 3 times, at first:\nTraceback")
    assert "three failed 3 times" in text
    assert "two" not in text
    assert text.count("OSError: no disk") == 2


class Mute(Exception):  # noqa: N818
    def __str__(self) -> str:
        raise ValueError("not even that")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ValueError("two\n  lines"), "ValueError: two lines"),
        (ValueError("x" * 400), "ValueError: " + "x" * 300),
        (ValueError(), "ValueError"),
        (Mute(), "Mute: its text is not available"),
    ],
)
def test_an_exception_in_one_line(error: Exception, text: str) -> None:
    assert in_one_line(error) == text
