"""A call that joins stages gives what they give one by one, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop import configured

from tonus.runtime.control.allocation import Allocation
from tonus.runtime.control.controllers import Controller, Motion
from tonus.runtime.control.controllers.impedance import Pd
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.distribution_kernels import (
    DELIVERED,
    delivered,
    distribute_tick,
    opposition,
    prepare,
    tension_bounds,
)
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.tension import TensionLoop, drum_motion
from tonus.runtime.safety.sequence import Levels
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
        drums = np.zeros((3, CABLES))
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


class Drawn:
    """A controller that commands tensions, or one that does not."""

    tone, resting_stiffness = 1.0, 500.0

    def tensions(self, motion: Any, stiffness: float, centre: Any) -> Any:
        del motion, stiffness
        return centre + np.linspace(-4.0, 4.0, CABLES)


class Undrawn(Drawn):
    tensions = Controller.tensions


@pytest.mark.parametrize("controller", [Drawn(), Undrawn()])
@pytest.mark.parametrize("force", [0.0, 30.0, 900.0, np.nan])
@pytest.mark.parametrize("missing", [(), (2,)])
def test_an_allocation_in_one_call_is_that_of_its_parts(
    controller: Any, force: float, missing: tuple[int, ...]
) -> None:
    """Opposition, bounds, distribution, and what it delivers: within the bounds, at them, and
    without a number."""
    settings, tension = CONTROL.distribution, CONTROL.tension
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.array([0.05, -0.08, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]))
    matrix, lengths = kinematics.matrix, kinematics.lengths
    present = np.ones(CABLES, bool)
    present[list(missing)] = False
    measured, before = np.linspace(30.0, 60.0, CABLES), np.full(CABLES, 45.0)
    wrench = np.array([force, -0.5 * force, 25.0, 0.5, 0.0, -0.2])
    agonism, gradient, low, high, centre = (np.zeros(CABLES) for _ in range(5))
    bearing = np.zeros((6, CABLES))
    opposition(matrix, lengths, wrench[:3], settings.least_force, agonism, gradient)
    levels = (tension.min, tension.max, tension.pre, settings.tension_rate * CONTROL.rates.period)
    tension_bounds(matrix, before, present, levels, 0.0, agonism, low, high, centre, bearing)
    wanted = wrench.copy()
    if type(controller) is Drawn:
        centre = controller.tensions(None, 0.0, centre) * present
        wanted = matrix @ centre
    apart = TensionDistribution(settings, ROBOT.geometry.moment_length, CABLES)
    expected = apart(bearing, wanted, centre, low, high, gradient)
    force_missed, delivers = np.zeros(3), np.zeros(6)
    stiffness = delivered(matrix, expected, wanted, gradient, measured, delivers, force_missed)

    allocation = Allocation(ROBOT, CONTROL, controller, kinematics)
    allocation.reference[:], allocation.wrench[:] = before, wrench
    allocation.distribute(
        None,  # type: ignore[arg-type]
        controller.resting_stiffness,
        Levels(tension.min, tension.max, tension.pre),
        present,
        measured,
    )
    np.testing.assert_array_equal(allocation.reference, expected)
    np.testing.assert_array_equal(allocation.centre, centre)
    np.testing.assert_array_equal(allocation.agonism, agonism)
    np.testing.assert_array_equal(allocation.delivered, delivers)
    np.testing.assert_array_equal(allocation.shortfall, force_missed)
    np.testing.assert_equal(allocation.geometric, stiffness)
    found = allocation.distribution
    assert (found.solver, found.iterations) == (apart.solver, apart.iterations)
    np.testing.assert_equal(found.deficit, apart.deficit)


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


class Stages:
    """What the distribution of a tick is asked and has, arrays of its own."""

    def __init__(self) -> None:
        kinematics = Kinematics(ROBOT.geometry)
        kinematics.evaluate(np.array(ROBOT.home), np.array([1.0, 0.0, 0.0, 0.0]))
        self.distribution = TensionDistribution(
            CONTROL.distribution, ROBOT.geometry.moment_length, CABLES
        )
        self.matrix, self.lengths = kinematics.matrix, kinematics.lengths
        self.tensions = np.full(CABLES, 7.0)
        self.measured = np.linspace(30.0, 60.0, CABLES)
        self.cables, bearing = np.full((5, CABLES), 7.0), np.full((6, CABLES), 7.0)
        self.prepared = [*self.cables, bearing]
        wrenches = self.distribution.wrenches
        wrenches[DELIVERED] = 7.0
        self.delivered = [wrenches[DELIVERED], np.full(3, 7.0)]

    def prepare(self, wrench: np.ndarray) -> None:
        prepare(self.matrix, self.lengths, wrench[:3], *self._levels, 5.0, 400.0, *self.prepared)

    def step(self, wrench: np.ndarray, *, prepared: bool) -> tuple[bool, bool, float, float]:
        return distribute_tick(
            prepared,
            self.matrix,
            self.lengths,
            wrench,
            *self._levels,
            self.measured,
            self.tensions,
            self.cables,
            self.prepared[5],
            self.distribution.scaled,
            self.distribution.normal,
            self.distribution.wrenches,
            self.delivered[1],
            np.array([5.0, 400.0, *self.distribution.weights]),
        )

    @property
    def _levels(self) -> tuple[object, ...]:
        before, present = np.full(CABLES, 50.0), np.ones(CABLES, dtype=bool)
        return before, present, 20.0, 200.0, 50.0, 0.3


WITHIN = np.array([3.0, -2.0, ROBOT.platform.mass * ROBOT.gravity, 0.1, 0.0, -0.1])


@pytest.mark.parametrize("prepared", [True, False])
def test_a_distribution_in_one_call_is_that_of_its_stages(prepared: bool) -> None:
    together, apart = Stages(), Stages()
    apart.prepare(WITHIN)
    if prepared:
        together.prepare(WITHIN)
        # As a controller that commands tensions leaves them.
        for stages in (together, apart):
            stages.prepared[4][:] = np.linspace(48.0, 52.0, CABLES)
    inside, finite, deficit, geometric = together.step(WITHIN, prepared=prepared)
    _, gradient, low, high, centre, bearing = apart.prepared
    found = apart.distribution(bearing, WITHIN, centre, low, high, gradient)
    assert (apart.distribution.iterations, inside, finite) == (0, True, True)
    assert together.tensions.tobytes() == found.tobytes()
    assert deficit == apart.distribution.deficit
    for one, other in zip(together.prepared, apart.prepared, strict=True):
        np.testing.assert_array_equal(one, other)
    expected = delivered(apart.matrix, found, WITHIN, gradient, apart.measured, *apart.delivered)
    assert geometric == expected != 0.0
    for one, other in zip(together.delivered, apart.delivered, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("wrench", [30.0 * WITHIN, np.full(6, np.nan)])
def test_where_the_free_minimiser_is_no_answer_nothing_is_delivered_yet(
    wrench: np.ndarray,
) -> None:
    together = Stages()
    inside, finite, _, geometric = together.step(wrench, prepared=False)
    assert (inside, finite) == (bool(np.isnan(wrench).any()), False)
    assert geometric == 0.0
    assert [each.tolist() for each in together.delivered] == [[7.0] * 6, [7.0] * 3]
