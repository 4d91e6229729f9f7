"""Eq. (3) and eq. (10) with the paper's Table 1, worked out by hand."""

from __future__ import annotations

import pytest

from tonus.config import load
from tonus.config.schema.control import StiffnessLaw
from tonus.runtime.control.stiffness import Law

LAW = load("config/can.yaml")[0].control.stiffness


def law(**changes: object) -> Law:
    return Law(LAW.model_copy(update=changes))


@pytest.mark.parametrize(
    ("velocity", "force", "expected"),
    [
        (0.0, 0.0, 3210.0),
        (0.19, 0.0, 4237.2),  # 3210 (1 + 0.32)
        (0.0, 25.0, 3787.8),  # 3210 (1 + 0.18)
        (0.095, 12.5, 4012.5),  # 3210 (1 + 0.16 + 0.09)
        (9.0, 900.0, 4815.0),  # both ratios clipped: 3210 * 1.50
    ],
)
def test_equation_3_with_table_1(velocity: float, force: float, expected: float) -> None:
    assert law()(0.5, velocity, force) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("deviation", "velocity", "force", "expected"),
    [
        (0.015, 0.0, 0.0, 3723.6),  # 3210 (1 + 0.16)
        (0.030, 0.0, 0.0, 4237.2),
        (0.030, 0.19, 25.0, 4879.2),  # 3210 * 1.82, clipped to K_max = 3210 * 1.52
    ],
)
def test_equation_10_adds_the_deviation(
    deviation: float, velocity: float, force: float, expected: float
) -> None:
    found = law(profile="eq10", deviation_gain=0.32)(deviation, velocity, force)
    assert found == pytest.approx(expected, abs=1e-9)


def test_equation_3_has_no_deviation_term_whatever_its_gain() -> None:
    assert law(deviation_gain=0.32)(0.03, 0.0, 0.0) == 3210.0


def test_the_terms_add_up_to_what_they_made() -> None:
    found = law(profile="eq10", deviation_gain=0.1)
    stiffness = found(0.01, 0.05, 10.0)
    terms = found.terms
    rise = terms.deviation + terms.velocity + terms.force
    assert stiffness == terms.stiffness == pytest.approx(3210.0 * (1.0 + rise))


def test_schema_refuses_bounds_out_of_order() -> None:
    with pytest.raises(ValueError, match="minimum < base"):
        StiffnessLaw.model_validate(LAW.model_dump() | {"minimum": 5000.0})
