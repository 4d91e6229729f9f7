"""A call that joins stages gives what they give one by one, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from loop import configured

from tonus.runtime.control.controllers import Controller, Motion
from tonus.runtime.control.controllers.impedance import Pd
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.tension import TensionLoop, drum_motion
from tonus.runtime.safety.witness import _is_small

CONFIG = configured("hold")[0]
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
CABLES = ROBOT.cables


class Own(Pd):
    """`pd`, with a force of its own that is the same."""

    def force(self, motion: Motion, stiffness: float) -> np.ndarray:
        return Controller.force(self, motion, stiffness)


@pytest.mark.parametrize("seed", range(5))
def test_a_wrench_in_one_call_is_that_of_force_and_wrench(seed: int) -> None:
    draw = np.random.default_rng(seed)
    turn = draw.normal(size=4)
    vectors = [draw.normal(size=3) for _ in range(7)]
    motion = Motion(
        *vectors[:4],
        turn / np.linalg.norm(turn),
        *vectors[4:],
        1.0,
        draw.normal(size=3),
        np.zeros(CABLES),
        np.zeros(CABLES),
        draw.normal(size=3),
    )
    together, apart = Pd(ROBOT, CONTROL), Own(ROBOT, CONTROL)
    np.testing.assert_array_equal(together.wrench(motion, 700.0), apart.wrench(motion, 700.0))


@pytest.mark.parametrize("follows", [True, False])
def test_a_loop_that_follows_is_the_motion_of_the_drums_and_the_loop(follows: bool) -> None:
    draw = np.random.default_rng(int(follows))
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.array(ROBOT.home), np.array([1.0, 0.0, 0.0, 0.0]))
    loops = [TensionLoop(ROBOT, CONTROL.tension_loop, CONTROL.rates.period) for _ in range(2)]
    usable = np.ones(CABLES, dtype=bool)
    for _ in range(5):
        reference, measured, felt, rate = draw.uniform(20.0, 60.0, (4, CABLES))
        twist = (draw.normal(size=3), draw.normal(size=3))
        desired = tuple(draw.normal(size=3) for _ in range(4))
        drums = tuple(np.zeros(CABLES) for _ in range(3))
        assert loops[0].follow(
            kinematics.matrix,
            np.zeros(6),
            twist,
            desired,
            reference,
            measured,
            felt,
            rate,
            usable,
            kinematics.lengths,
            drums,
            follows=follows,
        )
        alone = tuple(np.zeros(CABLES) for _ in range(3))
        drum_motion(
            kinematics.matrix,
            np.zeros(6),
            measured,
            twist,
            desired,
            ROBOT.drum_radius,
            ROBOT.axial_stiffness,
            *alone,
        )
        against = alone[0] if follows else alone[1]
        torque = loops[1](reference, felt, against, rate, usable, kinematics.lengths, alone[1:])
        np.testing.assert_array_equal(drums, alone)
        np.testing.assert_array_equal(loops[0].torque, torque)


def test_a_step_that_looks_small_is_small() -> None:
    """What is not solved exactly would have been found to be below the limit."""
    draw = np.random.default_rng(1)
    kinematics = Kinematics(ROBOT.geometry)
    found = {True: 0, False: 0}
    for _ in range(300):
        kinematics.evaluate(draw.uniform(-0.2, 0.2, 3), np.array([1.0, 0.0, 0.0, 0.0]))
        step = draw.normal(0.0, 2e-3, CABLES)
        ways = kinematics.matrix[:3]
        shift = float(np.linalg.norm(np.linalg.solve(ways @ ways.T, ways @ step)))
        small = _is_small(kinematics.matrix, step, 2e-3)
        assert small == (shift < 2e-3)
        found[small] += 1
    assert min(found.values()) > 30
    for _ in range(300):
        # Of a robot whose cables all pull to one side, no direction is apart from the others.
        ways = draw.normal(0.0, 0.6, (6, CABLES)) + draw.normal(0.0, 1.0, (6, 1))
        shift = draw.normal(0.0, 1e-3, 3)
        step = shift @ ways[:3]
        size = float(np.linalg.norm(shift))
        assert _is_small(ways, step, 1.001 * size)
        assert not _is_small(ways, step, 0.999 * size)
    nothing = np.zeros((6, CABLES))
    assert not _is_small(nothing, np.zeros(CABLES), 1.0), "what has no solution is not small"
