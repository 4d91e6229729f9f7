"""The picture's own convex hull against scipy's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from tonus.config.loader import HERE
from tonus.tools.view.hull import hull
from tonus.tools.view.moment import Array


def _is_that_of_scipy(points: Array) -> None:
    triangles = points[hull(points)]
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # A wrong or missing triangle, one too many, or one turned inwards changes one of the three.
    inside = points.mean(axis=0)
    volumes = np.einsum("ij,ij->i", triangles[:, 0] - inside, crossed) / 6
    theirs = ConvexHull(points)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(theirs.volume, rel=1e-6)
    assert np.linalg.norm(crossed, axis=1).sum() / 2 == pytest.approx(theirs.area, rel=1e-6)


@pytest.mark.parametrize(
    "file", sorted((HERE / "robots").glob("*.yaml")), ids=lambda file: file.stem
)
def test_the_hull_of_each_robots_anchors_is_that_of_scipy(file: Path) -> None:
    robot = yaml.safe_load(file.read_text())
    for anchors in robot["geometry"]["platform"], robot["geometry"]["frame"]:
        points = np.array(anchors, float)
        if np.linalg.matrix_rank(points - points[0]) == 3:
            _is_that_of_scipy(points)
        else:
            assert not len(hull(points))


def test_points_within_a_face_and_on_an_edge_are_no_corners() -> None:
    box = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
    more = np.array([[0.5, 1.0, 0.0], [0.5, 0.0, 0.0], [0.5, 1.0, 1.5], [0.0, 0.0, 1.0]])
    _is_that_of_scipy(np.concatenate([more, box]))
    assert not {8, 9, 10, 11} & set(hull(np.concatenate([box, more])).ravel().tolist())


@given(st.integers(0, 2**32 - 1), st.integers(4, 12), st.floats(0.01, 10.0))
def test_the_hull_of_any_points_is_that_of_scipy(seed: int, count: int, size: float) -> None:
    _is_that_of_scipy(size * np.random.default_rng(seed).normal(size=(count, 3)))


def test_points_in_a_plane_have_none() -> None:
    flat = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1], [2, 1, 1], [1, 2, 1]], float)
    assert hull(flat).shape == (0, 3)
