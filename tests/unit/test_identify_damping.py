"""Damping of the cables from made-up elongations: each cable's tension by its own law, on a grid
ten times as fine, whatever moves the platform."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter
from scipy.spatial.transform import Rotation

from tonus.config import Config, load
from tonus.runtime.states import State
from tonus.tools.identify.damping import has_null_space, identify_damping
from tonus.tools.identify.estimate import Estimate
from tonus.tools.identify.record import Record
from tonus.tools.log import Log

Array = NDArray[np.float64]
CONFIG, _ = load("config/direct.yaml")
UNLIKE, _ = load("config/unlike_axes.yaml")
FINE, ROWS = 10, 8_000
STEP = 1e-3 / FINE
TIME = np.arange(FINE * ROWS) * STEP
COUNT = 2.0 * np.pi / 50176.0
"""rad of a drum"""


def sines(random: np.random.Generator, columns: int, sizes: dict[float, float]) -> Array:
    """(n, columns): at each frequency (Hz) of this size, with phases of their own."""
    phases = random.uniform(0.0, 2.0 * np.pi, (len(sizes), columns))
    return np.asarray(
        sum(
            size * np.sin(2.0 * np.pi * f * TIME[:, None] + phase)
            for (f, size), phase in zip(sizes.items(), phases, strict=True)
        )
    )


def made_up(
    seed: int,
    damping: Array,
    *,
    config: Config = CONFIG,
    stretched: float = 1.0,
    noise: float = 0.05,
    pole: float = 500.0,
) -> Record:
    """A platform on slow sines while each cable is stretched at its own will, 16 µm to 100 µm about
    15 mm, ``stretched`` times; the cells have ``noise`` (N) and a bandwidth of ``pole`` (Hz)."""
    robot, random = config.robot, np.random.default_rng(seed)
    cables = robot.cables
    position = sines(random, 3, {0.3: 0.02, 0.9: 0.008}) + np.array(robot.home)
    turns = Rotation.from_rotvec(sines(random, 3, {0.5: 0.01}))
    tips = np.stack([turns.apply(tip) for tip in robot.geometry.platform], axis=1)
    away = np.array(robot.geometry.frame) - position[:, None, :] - tips
    length = np.linalg.norm(away, axis=2)
    swing = {1.7: 1e-4, 3.1: 8e-5, 5.3: 5e-5, 8.9: 3e-5, 12.7: 1.6e-5}
    stretch = 0.015 + stretched * sines(random, cables, swing)
    free = length - stretch
    rate = np.gradient(stretch, STEP, axis=0)
    pull = robot.axial_stiffness / free * stretch + damping * rate
    behind = 2.0 * np.pi * pole
    pulled = lfilter(*bilinear([behind], [1.0, behind], 1.0 / STEP), pull - pull[0], axis=0)
    tension = (pulled + pull[0])[::FINE]
    angle = np.floor((free[0] - free[::FINE]) / robot.drum_radius / COUNT) * COUNT
    seen = np.arange(0, ROWS, 8)
    return Record(
        path=Path("made-up.mcap"),
        log=cast(Log, None),
        config=config,
        period=1e-3,
        time=TIME[::FINE],
        state=np.full(ROWS, State.ACTIVE, dtype=np.uint8),
        angle=angle,
        torque=np.zeros((ROWS, cables)),
        tension=tension + noise * random.standard_normal(tension.shape),
        desired=position[::FINE],
        stiffness=np.zeros(ROWS),
        good=np.ones(ROWS, dtype=bool),
        ticks=np.arange(ROWS),
        exposure=TIME[::FINE][seen],
        seen_position=position[::FINE][seen] + 5e-5 * random.standard_normal((len(seen), 3)),
        seen_rotation=turns[::FINE][seen]
        * Rotation.from_rotvec(1e-3 * random.standard_normal((len(seen), 3))),
    )


def of(*records: Record, cables: tuple[Estimate, ...] = ()) -> Estimate:
    (found,) = identify_damping(records, cables)
    return found


@pytest.mark.parametrize("true", [2.0, 15.0])
def test_the_damping_lies_in_its_interval(true: float) -> None:
    found = of(made_up(1, np.full(8, true)))
    assert found.key == "robot.cable.damping"
    assert found.configured == 6.0
    assert abs(found.value - true) <= found.half_width
    assert found.half_width < 1.0


@pytest.mark.wide
def test_the_intervals_hold_over_drawn_robots_and_do_not_lean_to_one_side() -> None:
    """Stretched half as much, so that noise counts and not only the doubt of the cells."""
    random = np.random.default_rng(5)
    true = random.uniform(2.0, 15.0, 12)
    found = [of(made_up(seed, np.full(8, c), stretched=0.5)) for seed, c in enumerate(true)]
    errors = np.array([each.value for each in found]) - true
    widths = np.array([each.half_width for each in found])
    assert np.mean(np.abs(errors) <= widths) >= 0.8
    assert np.abs(errors.mean()) < 3.0 * errors.std(ddof=1) / np.sqrt(len(true))
    assert 0.5 < np.median(widths) / (1.96 * errors.std(ddof=1)) < 2.0


def test_a_slower_cell_is_not_taken_for_less_damping() -> None:
    """Where the configuration says that it is slow; as fast as that of the others it costs what it
    is late, in newtons a metre times the seconds."""
    slow, _ = load("config/direct.yaml", overrides={"lab.noise.force_cell.bandwidth_hz": 150.0})
    told = of(made_up(1, np.full(8, 6.0), config=slow, pole=150.0))
    assert abs(told.value - 6.0) <= told.half_width
    hidden = of(made_up(1, np.full(8, 6.0), pole=150.0))
    late = 1.0 / (2.0 * np.pi * 150.0) - 1.0 / (2.0 * np.pi * 500.0)
    assert hidden.value == pytest.approx(6.0 - late * 3600.0 / 1.13, abs=0.4)


def test_each_configured_damping_has_its_own_value() -> None:
    true = np.array([4.0, 4.0, 4.0, 4.0, 11.0, 11.0, 11.0, 4.0])
    record = made_up(2, true, config=UNLIKE, stretched=3.0)
    found = {each.axes: each for each in identify_damping([record], [])}
    values = {found[axes].key: (found[axes].value, found[axes].half_width) for axes in found}
    value, half_width = values["robot.cable.damping"]
    assert abs(value - 4.0) <= half_width < 1.0
    value, half_width = values["robot.axes.{}.cable.damping"]
    assert abs(value - 11.0) <= half_width < 1.5
    assert set(found) == {(0, 1, 2, 3, 7), (4, 5, 6)}


def test_cables_that_are_not_stretched_against_each_other_say_nothing() -> None:
    assert identify_damping([made_up(1, np.full(8, 6.0), stretched=0.0)], []) == []


def test_six_cables_say_nothing() -> None:
    six, _ = load("config/six.yaml")
    record = made_up(1, np.full(6, 6.0), config=six)
    assert not has_null_space(record)
    assert identify_damping([record], []) == []
