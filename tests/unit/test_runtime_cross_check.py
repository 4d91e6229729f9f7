"""What is compared with what once a tick's torques are sent, and when."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonus.runtime.safety.cross_check import CrossCheck

N = 8
FIELDS = [("force", float), ("age", np.uint16)]


class Noted:
    """Stands in for drum observer, isolation and witness; notes what it is called with."""

    def __init__(self) -> None:
        self.called: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {}
        self.turned = np.zeros(N, bool)

    def note(self, name: str, *given: Any, **named: Any) -> None:
        self.called[name] = given, named

    def __getattr__(self, name: str) -> Any:
        return lambda *given, **named: self.note(name, *given, **named)

    def freed(self, angle: Any) -> Any:
        self.note("freed", angle)
        return self.turned


@pytest.fixture
def parts() -> SimpleNamespace:
    faults = SimpleNamespace(
        failed=np.zeros(N, bool),
        held=np.arange(N) == 6,
        freed=np.arange(N) == 1,
        drums_readable=np.arange(N) != 3,
        drums_obedient=np.arange(N) != 4,
    )
    return SimpleNamespace(
        sensing=SimpleNamespace(
            tension=np.arange(N) + 1.0, angle=np.arange(N) + 2.0, filtered=np.arange(N) + 3.0
        ),
        sequence=SimpleNamespace(
            faults=faults, enabled=True, regulating=True, passive_share=-1.0, referenced=True,
            sound=np.ones(N, bool),
        ),
        referencing=SimpleNamespace(measured=np.arange(N) + 4.0),
        estimator=SimpleNamespace(innovations=np.arange(N) + 5.0, doubts=np.arange(N) + 6.0),
        isolation=Noted(),
        witness=Noted(),
        image=SimpleNamespace(
            cells=np.array([(10.0 + n, n) for n in range(N + 1)], FIELDS),
            cell=SimpleNamespace(force=np.zeros(N + 1), age=np.zeros(N + 1, np.uint16)),
        ),
    )  # fmt: skip


def finished(
    parts: SimpleNamespace, *taking_up: int, skipped: bool = True
) -> tuple[CrossCheck, Noted]:
    """A tick; what the drums were observed with."""
    drums = parts.isolation.drums = Noted()
    parts.isolation.given_up = Noted()
    check = CrossCheck(
        parts.sensing,
        parts.sequence,
        parts.referencing,
        parts.estimator,
        parts.isolation,
        parts.witness,
    )
    slack = np.isin(np.arange(N), taking_up)
    check.begin(np.arange(N) + 7.0, np.arange(N) + 8.0, np.arange(N) + 9.0, slack, skipped=skipped)
    check.finish(parts.image)
    return check, drums


def test_drums_of_given_up_cables_are_not_observed_but_where_they_took_up_slack(
    parts: SimpleNamespace,
) -> None:
    parts.sequence.faults.failed[[2, 5]] = True
    _, drums = finished(parts, 5, 7)
    (_, sensing, failed, torque, following), named = drums.called["step"]
    assert sensing is parts.sensing
    assert failed.nonzero()[0].tolist() == [2]
    assert (torque[0], following[0]) == (7.0, 8.0)
    assert named == {"skipped": True, "enabled": True}


@pytest.mark.parametrize(
    ("enabled", "skipped", "watched"),
    [(True, False, [2, 6]), (False, False, []), (True, True, [])],
)
def test_drums_of_given_up_cables_are_watched_without_their_cells(
    parts: SimpleNamespace, enabled: bool, skipped: bool, watched: list[int]
) -> None:
    """But for those that take up slack, are not readable, or have disobeyed already."""
    parts.sequence.faults.failed[[2, 3, 4, 5, 6]] = True
    parts.sequence.enabled = enabled
    finished(parts, 5, skipped=skipped)
    (image, sensing, mask, torque), _ = parts.isolation.given_up.called["step"]
    assert (image, sensing) == (parts.image, parts.sensing)
    assert mask.nonzero()[0].tolist() == watched
    assert torque[0] == 7.0


@pytest.mark.parametrize("failed", [[], [3], list(range(N))])
def test_drums_of_failed_drives_are_watched_where_there_are_any(
    parts: SimpleNamespace, failed: list[int]
) -> None:
    parts.sequence.faults.failed[failed] = True
    parts.isolation.turned[4] = True
    finished(parts)
    assert ("unwound" in parts.isolation.called) == bool(failed)
    assert parts.sequence.faults.freed.nonzero()[0].tolist() == ([1, 4] if failed else [1])
    if failed:
        (force, age, tension, angle, held), _ = parts.isolation.called["unwound"]
        assert force.tolist() == [10.0 + n for n in range(N)]
        assert age.tolist() == list(range(N))
        assert tension is parts.sensing.tension
        assert angle is parts.sensing.angle
        assert held is parts.sequence.faults.held


@pytest.mark.parametrize(
    ("regulating", "passive", "referenced", "witness", "residuals"),
    [
        (True, -1.0, True, True, True),
        (False, 0.0, True, True, False),
        (False, 0.5, True, True, False),
        (False, -1.0, True, False, False),
        (False, 0.5, False, False, False),
        (True, 0.5, False, True, True),
    ],
)
def test_lengths_are_compared_where_there_is_a_reference(
    parts: SimpleNamespace,
    regulating: bool,
    passive: float,
    referenced: bool,
    witness: bool,
    residuals: bool,
) -> None:
    """With the tracker's poses while the robot is regulated, and in a passive stop; with each other
    while it is regulated."""
    sequence = parts.sequence
    sequence.regulating, sequence.passive_share = regulating, passive
    sequence.referenced = referenced
    finished(parts)
    assert ("step" in parts.witness.called) is witness
    assert ("step" in parts.isolation.called) is residuals


def test_nothing_is_compared_twice(parts: SimpleNamespace) -> None:
    check, drums = finished(parts)
    drums.called.clear()
    check.finish(parts.image)
    assert not drums.called
