"""Answers of a linear system by eigenvalues, against a linear system solved at each frequency."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.tools.margins.response import frequency_response

Z = np.exp(2j * np.pi * np.linspace(1e-3, 0.5, 200))


@pytest.mark.parametrize("size", [1, 2, 5, 20])
def test_answers_are_those_of_the_linear_systems(size: int) -> None:
    random = np.random.default_rng(size)
    for radius in (0.3, 0.9, 1.3):
        matrix = random.normal(size=(size, size))
        matrix *= radius / np.abs(np.linalg.eigvals(matrix)).max()
        entry, exits = random.normal(size=size), random.normal(size=(3, size))
        shifted = Z[:, None, None] * np.eye(size) - matrix
        driven = np.linalg.solve(shifted, entry[:, None].astype(complex))[:, :, 0]
        expected = exits @ driven.T
        found = frequency_response(matrix, entry, exits, Z)
        assert found.shape == (3, len(Z))
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_delays_alone_whose_eigenvalues_are_all_zero() -> None:
    """A chain of delays is defective: its eigenvalues are found inexactly, its answer is not."""
    delays = np.eye(6, k=-1)
    (found,) = frequency_response(delays, np.eye(6)[0], np.eye(6)[5:], Z)
    assert np.abs(found - Z**-6.0).max() < 1e-9
