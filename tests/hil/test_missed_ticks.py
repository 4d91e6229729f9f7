"""A host that takes ticks, or is late: torque and motion are of different times then, and the
platform moves on while nobody looks."""

from __future__ import annotations

import numpy as np

from tests.loop import QUICK, ClosedLoop, configured
from tonus.runtime.operation.reporter import Reporter
from tonus.runtime.states import Fault, State


def test_ticks_that_are_missed_are_blamed_on_no_drum() -> None:
    """Two of seven, while the platform moves."""
    loop = ClosedLoop(*configured("sine_x", QUICK))
    loop.until(State.ACTIVE)
    for _ in range(300):
        for missed in (0, 0, 1, 0, 1):
            loop.number += missed
            loop.tick()
    assert loop.cycle.sequence.fault is Fault.NONE


def test_late_ticks_are_blamed_on_no_drum() -> None:
    """Up to 0.8 ms, from the lifting on: the drums turn fastest there."""
    loop = ClosedLoop(*configured("sine_x", QUICK))
    loop.until(State.PRETENSION)
    random = np.random.default_rng(5)
    for _ in range(2500):
        loop.late_ns = int(random.integers(0, 800_000)) if random.random() < 0.5 else 0
        loop.tick()
    assert loop.cycle.sequence.fault is Fault.NONE


def test_the_estimate_moves_on_while_ticks_are_missed() -> None:
    """Forty at once, in the middle of the lifting at 0.18 m/s."""
    loop = ClosedLoop(*configured("sine_x", QUICK))
    loop.until(State.PRETENSION)
    loop.run(0.9)
    assert loop.trace.truth["velocity"][-1, 2] > 0.1
    loop.number += 40
    loop.run(0.005)
    pose, truth = loop.cycle.record.pose, loop.trace.truth[-1]
    np.testing.assert_allclose(pose.velocity, truth["velocity"], atol=0.05)
    np.testing.assert_allclose(pose.position, truth["position"], atol=2e-3)
    assert loop.cycle.sequence.fault is Fault.NONE


def test_drums_that_cannot_be_observed_are_a_named_mode() -> None:
    config, scenario = configured("hold", QUICK)
    loop, told = ClosedLoop(config, scenario), list[str]()
    loop.until(State.HOLD)
    reporter = Reporter(
        config, loop.cycle, loop.image, lambda _s, _t, _l, name, _w, _x: told.append(name)
    )
    for late_ns, ticks in ((0, 300), (200_000, 150), (0, 5), (200_000, 250), (0, 10)):
        for _ in range(ticks):
            loop.image.axes["doubt_ns"] = late_ns
            loop.tick()
            reporter.look(0, loop.number)
    assert [name for name in told if "observed" in name] == ["drums_unobserved", "drums_observed"]
