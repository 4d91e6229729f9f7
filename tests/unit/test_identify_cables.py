"""EA from made-up bring-ups: a platform that is lifted while its cables are tightened."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tonus.config import load
from tonus.runtime.states import State
from tonus.tools.identify.cables import identify_cables
from tonus.tools.identify.record import Record
from tonus.tools.log import Log

Array = NDArray[np.float64]
CONFIG, _ = load("config/direct.yaml")
ROBOT = CONFIG.robot
ROWS = 3000
TIME = np.arange(ROWS) * 1e-3
TRUE = np.array([3000.0, 3200.0, 3400.0, 3600.0, 3800.0, 4000.0, 4200.0, 4400.0])
FRAME, TIPS = np.array(ROBOT.geometry.frame), np.array(ROBOT.geometry.platform)


def bring_up(seed: int, *, late: float = 0.0, tightened: float = 33.0) -> Record:
    """12 N at rest, then ``tightened`` N more and 0.1 m up within 2 s; the tracker has noise, and
    its clock is ``late`` s."""
    random = np.random.default_rng(seed)
    share = np.clip((TIME - 0.5) / 2.0, 0.0, 1.0)
    lift = 0.5 - 0.5 * np.cos(np.pi * share)
    position = np.outer(1.0 - lift, ROBOT.rest)
    tension = 12.0 + tightened * lift[:, None] * np.linspace(0.9, 1.1, 8)
    length = np.linalg.norm(FRAME - position[:, None, :] - TIPS, axis=2)
    unstretched = length / (1.0 + tension / TRUE)
    angle = (unstretched[0] - unstretched) / ROBOT.drum.radius
    seen = np.arange(50, ROWS, 8)
    turn = Rotation.from_rotvec(1e-3 * random.standard_normal((len(seen), 3)))
    return Record(
        path=Path("made-up.mcap"),
        log=cast(Log, None),
        config=CONFIG,
        period=1e-3,
        time=TIME,
        state=np.full(ROWS, State.PRETENSION, dtype=np.uint8),
        angle=angle,
        torque=np.zeros((ROWS, 8)),
        tension=tension + 0.05 * random.standard_normal(tension.shape),
        desired=position,
        stiffness=np.zeros(ROWS),
        good=np.ones(ROWS, dtype=bool),
        ticks=np.arange(ROWS),
        exposure=TIME[seen] + late,
        seen_position=position[seen] + 6e-5 * random.standard_normal((len(seen), 3)),
        seen_rotation=turn,
    )


def test_every_cable_has_its_own_stiffness_and_the_interval_of_the_mean_holds() -> None:
    held, errors = [], []
    for seed in range(15):
        (found,) = identify_cables([bring_up(seed)], 0.0)
        assert found.half_width < 0.01 * TRUE.mean()
        held.append(abs(found.value - TRUE.mean()) <= found.half_width)
        errors.append(np.array(found.each) / TRUE - 1.0)
    assert np.mean(held) >= 0.8
    assert np.abs(np.mean(errors, axis=0)).max() < 0.01


def test_a_tracker_that_is_late_changes_nothing() -> None:
    (found,) = identify_cables([bring_up(1)], 0.0)
    (late,) = identify_cables([bring_up(1, late=5e-3)], 0.0)
    assert late.value == pytest.approx(found.value, rel=2e-3)


def test_doubtful_anchors_widen_the_interval() -> None:
    (sure,) = identify_cables([bring_up(1)], 0.0)
    (doubtful,) = identify_cables([bring_up(1)], 2e-3)
    assert doubtful.value == sure.value
    assert doubtful.half_width > 1.5 * sure.half_width


def test_tensions_that_hardly_change_say_nothing() -> None:
    assert identify_cables([bring_up(1, tightened=3.0)], 0.0) == []
