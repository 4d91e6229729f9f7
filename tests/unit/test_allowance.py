"""What is allowed after a torn cable, from a table made up and from the one that ships."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.config import load
from tonus.config.loader import load_least_stops
from tonus.config.schema.least_stop import LeastStops, Stop, Tear
from tonus.tools.campaign.allowance import allowance, optimum

GEOMETRY = load("config/direct.yaml")[0].robot.geometry
STILL = (0.0, 0.0, 0.0)


def stop(speed: float) -> Stop:
    return Stop(speed=speed, tension=100.0 * speed)


CENTRE = Tear(cable=0, position=(0.0, 0.0, 0.0), rest=stop(0.2), towards=stop(0.3), away=stop(0.4))
ASIDE = Tear(cable=0, position=(0.1, 0.0, 0.0), rest=stop(0.5))
TABLE = LeastStops(
    computed="2026-01-01", model="made up", delay=0.003, speed_limit=0.25, tears=(CENTRE, ASIDE)
)
ALONG = np.array(GEOMETRY.frame[0]) / np.linalg.norm(GEOMETRY.frame[0])


def test_twice_the_optimum_is_allowed() -> None:
    allowed = allowance(GEOMETRY, 0, STILL, STILL, TABLE)
    assert (allowed.speed, allowed.tension) == (pytest.approx(0.4), pytest.approx(40.0))


def test_the_nearest_pose_counts() -> None:
    assert optimum(GEOMETRY, 0, (0.04, 0.0, 0.0), STILL, TABLE) == CENTRE.rest
    assert optimum(GEOMETRY, 0, (0.06, 0.0, 0.0), STILL, TABLE) == ASIDE.rest


@pytest.mark.parametrize(
    ("speed", "motion"), [(0.1, "rest"), (0.2, "towards"), (-0.1, "rest"), (-0.2, "away")]
)
def test_the_motion_along_the_way_to_the_anchor_counts(speed: float, motion: str) -> None:
    assert optimum(GEOMETRY, 0, STILL, speed * ALONG, TABLE) == getattr(CENTRE, motion)


def test_a_pose_without_the_motion_is_passed_over() -> None:
    assert optimum(GEOMETRY, 0, ASIDE.position, 0.25 * ALONG, TABLE) == CENTRE.towards


def test_a_cable_without_an_entry_is_an_error() -> None:
    with pytest.raises(ValueError, match="cable 3"):
        optimum(GEOMETRY, 3, STILL, STILL, TABLE)


def test_the_table_has_every_cable_at_27_poses_at_rest() -> None:
    table = load_least_stops()
    assert {tear.cable for tear in table.tears} == set(range(8))
    assert len({(tear.cable, tear.position) for tear in table.tears}) == 8 * 27


def test_the_table_is_symmetric_in_the_planes_of_the_robot() -> None:
    table = {(t.cable, t.position): t.rest for t in load_least_stops().tears}
    for (cable, (x, y, z)), least in table.items():
        anchor = np.array(GEOMETRY.frame[cable]) * (-1.0, 1.0, 1.0)
        other = int(np.argmin(np.linalg.norm(np.array(GEOMETRY.frame) - anchor, axis=1)))
        assert table[other, (0.0 - x, y, z)] == least


def test_an_upper_cable_is_worse_to_lose_than_a_lower_one() -> None:
    tears = load_least_stops().tears
    upper = [tear.rest.speed for tear in tears if tear.cable < 4]
    lower = [tear.rest.speed for tear in tears if tear.cable >= 4]
    assert np.median(upper) > 1.2 * np.median(lower)
    assert max(upper) > max(lower)
