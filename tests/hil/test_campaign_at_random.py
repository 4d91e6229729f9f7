"""Faults at random on the direct fieldbus, each episode held against every bound."""

from __future__ import annotations

import os
from typing import Any

import pytest

from tests.hil.not_yet_kept import NOT_YET_KEPT
from tonus.config.loader import load_study
from tonus.tools.campaign.campaign import played
from tonus.tools.campaign.draw import episodes

pytestmark = pytest.mark.wide

STUDY = load_study("faults")
EPISODES = int(os.environ.get("TONUS_EPISODES", "8"))
SEED = int(os.environ.get("TONUS_CAMPAIGN_SEED", "1"))
WORKERS = int(os.environ.get("TONUS_CAMPAIGN_WORKERS", "1"))
"""the other processor has tests of its own"""


def test_no_fault_breaks_a_bound() -> None:
    todo = episodes(STUDY, SEED, ["direct"], EPISODES)
    rows = list(played(STUDY, todo, WORKERS))
    assert sorted(row["index"] for row in rows) == list(range(EPISODES))
    broken: list[tuple[int, Any]] = [
        (row["index"], violation)
        for row in rows
        for violation in row["violations"]
        if violation["invariant"] not in NOT_YET_KEPT
    ]
    assert broken == []
