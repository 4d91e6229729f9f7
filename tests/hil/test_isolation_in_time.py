"""A broken cable, drum, cell or encoder is found in time and named; `make isolation` tries more."""

from __future__ import annotations

import pytest

from tests.isolated import BROKEN, play
from tests.torn import Torn
from tonus.config.loader import load_bounds

pytestmark = pytest.mark.wide

CHOSEN = (
    ("cable_cut", ""),
    ("drum_slip", "20 mm"),
    ("cell_gain", "0.8"),
    ("cell_offset", "20 N"),
    ("encoder_slip", "0.25 rad"),
    ("drum_jam", ""),
)


@pytest.fixture(scope="module")
def robot() -> Torn:
    return Torn((0.0, 0.0, 0.0))


def test_every_budget_is_tried_here() -> None:
    assert {kind for kind, _ in CHOSEN} == set(load_bounds().found_within)


@pytest.mark.parametrize("chosen", CHOSEN, ids=" ".join)
def test_it_is_found_in_time_and_named(robot: Torn, chosen: tuple[str, str]) -> None:
    (broken,) = (each for each in BROKEN if (each.kind, each.size) == chosen)
    case = next(iter(play(robot, broken, cable=5)))
    assert broken.right(case), case
    assert case.found_after is not None, case
    assert case.found_after <= load_bounds().found_within[broken.kind], case
    assert case.at_rest, case
