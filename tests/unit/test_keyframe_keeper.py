"""A keyframe that is written down before a run goes on is the one that would have been written."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.runtime.recording.keyframe import KeyframeError
from tonus.runtime.recording.keyframe_keeper import KeyframeKeeper

_EVERY = 3
"""ticks between two keyframes"""


@dataclass
class _Owner:
    values: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    other: object = 0.0


def _keeper(owner: _Owner) -> tuple[KeyframeKeeper, list[bytes]]:
    states: list[bytes] = []
    keeper = KeyframeKeeper(owner, lambda _stamp, _tick, state: states.append(state), _EVERY)
    return keeper, states


def test_a_prepared_keyframe_is_that_of_now() -> None:
    owner = _Owner()
    keeper, states = _keeper(owner)
    owner.values[1] = 2.5
    keeper.now(1, 1)
    keeper.prepare()
    keeper.now(1, 1)
    assert states[0] == states[1]


def test_a_prepared_keyframe_is_not_written_again() -> None:
    owner = _Owner()
    keeper, states = _keeper(owner)
    keeper.prepare()
    keeper.now(1, 1)
    owner.values[1] = 2.5  # what nobody does who has prepared it: shows where it comes from
    keeper.now(1, 1)
    assert states[0] == states[1]


def test_a_tick_voids_a_prepared_keyframe() -> None:
    owner = _Owner()
    keeper, states = _keeper(owner)
    keeper.now(1, 1)
    keeper.prepare()
    keeper(2, 2)
    owner.values[1] = 2.5
    keeper.now(3, 3)
    assert states[0] != states[1]


def test_a_state_that_cannot_be_kept_is_told_only_where_it_is_wanted() -> None:
    owner = _Owner()
    keeper, states = _keeper(owner)
    owner.other = iter(())
    keeper.prepare()
    with pytest.raises(KeyframeError):
        keeper.now(1, 1)
    assert not states
