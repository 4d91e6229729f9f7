"""The inner tension loop (eq. 6 and 9, completed) and the margins of its stability."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from tonus.config import load
from tonus.config.schema.control import TensionLoop as Settings
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.tension import TensionLoop
from tonus.tools.margins.tension_loop import DELAY_TICKS, Margins, margins_of, tension_loop_margins

CONFIG, _ = load("config/can.yaml")
ROBOT, SETTINGS = CONFIG.robot, CONFIG.control.tension_loop
PERIOD = CONFIG.control.rates.period
USABLE, LONG = np.ones(8, dtype=bool), np.full(8, 1.2)
ZERO = np.zeros(8)
LIMIT = ROBOT.motor.current_limit * ROBOT.motor.torque_constant * ROBOT.gearbox.ratio
Array = NDArray[np.float64]


def loop(**changes: Any) -> TensionLoop:
    return TensionLoop(ROBOT, SETTINGS.model_copy(update=changes), PERIOD)


def test_met_tension_needs_just_the_feed_forward() -> None:
    tension = np.full(8, 45.0)
    torque = loop()(tension, tension, ZERO, ZERO, USABLE, LONG)
    np.testing.assert_allclose(torque, ROBOT.drum.radius * 45.0, rtol=1e-14)


def test_each_term_stands_alone_and_points_the_right_way() -> None:
    quiet = {"proportional": 0.0, "integral": 0.0, "rate_damping": 0.0}
    r, ref, low = ROBOT.drum.radius, np.full(8, 45.0), np.full(8, 44.0)
    p = loop(**(quiet | {"proportional": 25.0}))(ref, low, ZERO, ZERO, USABLE, LONG)
    np.testing.assert_allclose(p, r * (45.0 + 25.0), rtol=1e-14)
    d = loop(**(quiet | {"rate_damping": 0.8}))(ref, ref, ZERO, np.full(8, 0.5), USABLE, LONG)
    np.testing.assert_allclose(d, r * 45.0 - 0.4, rtol=1e-14)
    follow = loop(**(quiet | {"rate_damping": 0.8}))(ref, ref, np.ones(8), np.ones(8), USABLE, LONG)
    np.testing.assert_allclose(follow, r * 45.0, rtol=1e-14)
    integrating = loop(**(quiet | {"integral": 100.0}))
    for n in range(1, 6):
        i = integrating(ref, low, ZERO, ZERO, USABLE, LONG)
        np.testing.assert_allclose(i, r * (45.0 + n * 100.0 * PERIOD), rtol=1e-14)


@pytest.mark.parametrize("rate", [2.0, -2.0], ids=["winding", "paying out"])
def test_on_the_desired_motion_the_drive_gets_what_it_will_take(rate: float) -> None:
    """By the balance of a drum at steady speed behind a gearbox that loses a fifth, and helps to
    hold when driven backwards."""
    tension, friction = np.full(8, 45.0), SETTINGS.friction
    speeds = (np.full(8, rate), np.full(8, 5.0))
    torque = loop()(tension, tension, ZERO, ZERO, USABLE, LONG, speeds)[0]
    efficiency = ROBOT.gearbox.efficiency
    through = efficiency if rate > 0.0 else 1.0 / efficiency
    drag = math.copysign(ROBOT.drum.radius * (friction.coulomb + friction.load * 45.0), rate)
    drag += ROBOT.drum.viscous_friction * rate
    accelerating = torque * through - ROBOT.drum.radius * 45.0 - drag
    assert accelerating == pytest.approx(ROBOT.drum.inertia * 5.0, abs=1e-4)


def test_a_change_asked_for_is_led_by_the_turn_it_takes_and_no_jump_makes_a_blow() -> None:
    """On a fixed platform the drum has to turn by l / (EA r) for each newton."""
    quiet = {"proportional": 0.0, "integral": 0.0, "feed_forward": 0.0, "rate_damping": 0.5}
    leading, slope = loop(**(quiet | {"lead": 1.0})), 100.0
    for n in range(500):
        torque = leading(np.full(8, slope * PERIOD * n), ZERO, ZERO, ZERO, USABLE, LONG)
        if n == 0:
            assert not torque.any(), "the first tick knows of no change"
    turn = slope * 1.2 / (ROBOT.cable.axial_stiffness * ROBOT.drum.radius)
    np.testing.assert_allclose(torque, 0.5 * turn, rtol=1e-6)
    jumped = leading(np.full(8, 500.0), ZERO, ZERO, ZERO, USABLE, LONG)
    assert (jumped < 0.5 * turn * SETTINGS.lead_rate / slope).all()
    leading.reset()
    assert not leading(np.full(8, 45.0), ZERO, ZERO, ZERO, USABLE, LONG).any()


def test_a_reference_that_was_no_number_for_a_tick_is_forgotten() -> None:
    leading, ref = loop(lead=1.0, integral=0.0), np.full(8, 45.0)
    for reference in (ref, np.full(8, np.nan), ref, ref):
        torque = leading(reference, ref, ZERO, ZERO, USABLE, LONG)
    np.testing.assert_allclose(torque, ROBOT.drum.radius * 45.0, rtol=1e-14)


def test_the_integral_is_bounded_and_comes_back_at_once() -> None:
    integrating = loop(proportional=0.0, rate_damping=0.0)
    ref = np.full(8, 45.0)
    for _ in range(5000):
        integrating(ref, ZERO, ZERO, ZERO, USABLE, LONG)
    np.testing.assert_array_equal(integrating.integral, SETTINGS.integral_limit)
    integrating(ref, ref + 5.0, ZERO, ZERO, USABLE, LONG)
    assert (integrating.integral < SETTINGS.integral_limit).all()


def test_a_loop_that_takes_over_goes_on_where_the_other_was() -> None:
    before, ref = loop(), np.full(8, 45.0)
    for _ in range(100):
        before(ref, ref - 1.0, ZERO, ZERO, USABLE, LONG)
    for integral, kept in ((SETTINGS.integral, before.integral), (0.0, ZERO)):
        after = loop(integral=integral)
        after.take_over(before)
        np.testing.assert_array_equal(after.integral, kept)


def test_torque_saturates_at_the_motors_current_limit() -> None:
    hard = loop()(np.full(8, 200.0), ZERO, ZERO, ZERO, USABLE, LONG)
    np.testing.assert_array_equal(hard, LIMIT)
    back = loop()(ZERO, np.full(8, 200.0), ZERO, ZERO, USABLE, LONG)
    np.testing.assert_array_equal(back, -LIMIT)


def test_an_untrusted_cable_gets_no_torque_and_forgets_its_integral() -> None:
    found, ref = loop(), np.full(8, 45.0)
    for _ in range(100):
        found(ref, ref - 1.0, ZERO, ZERO, USABLE, LONG)
    usable = USABLE.copy()
    usable[3] = False
    torque = found(ref, ref - 1.0, ZERO, ZERO, usable, LONG)
    assert torque[3] == 0.0
    assert found.integral[3] == 0.0
    assert (np.delete(torque, 3) > 0.0).all()
    found.reset()
    assert not found.integral.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", range(4))
def test_what_is_not_finite_makes_no_torque_on_its_cable_only(bad: float, where: int) -> None:
    arguments = (np.full(8, 45.0), np.full(8, 44.0), np.zeros(8), np.zeros(8))
    arguments[where][6] = bad
    torque = loop(integral=0.0)(*arguments, USABLE, LONG)
    assert torque[6] == 0.0
    assert np.isfinite(torque).all()
    assert (np.delete(torque, 6) > 0.0).all()


# --- margins -------------------------------------------------------------------------------------

LAB = CONFIG.lab
assert LAB is not None
CURRENT_HZ, CELL_HZ = LAB.plant.current_loop_hz, LAB.noise.force_cell.bandwidth_hz


def margins(
    settings: Settings = SETTINGS, length: float = 1.2, delay: int = DELAY_TICKS
) -> Margins:
    return tension_loop_margins(
        ROBOT.drive_trains[0],
        settings,
        PERIOD,
        cable_length=length,
        current_loop_hz=CURRENT_HZ,
        cell_bandwidth_hz=CELL_HZ,
        delay_ticks=delay,
    )


def closed_loop(
    factor: float, extra_delay: int = 0, length: float = 1.2, settings: Settings = SETTINGS
) -> Array:
    """State matrix of the sampled loop with its gain times ``factor``, built without transforms:
    drum angle, rate, torque, cell force; the last angle; the integral; torques still under way.
    """
    k, r, inertia = ROBOT.cable.axial_stiffness / length, ROBOT.drum.radius, ROBOT.drum.inertia
    c, b = ROBOT.cable.damping, ROBOT.drum.viscous_friction
    drive, cell = 2.0 * np.pi * CURRENT_HZ, 2.0 * np.pi * CELL_HZ
    flow = np.zeros((4, 4))
    flow[0, 1] = 1.0
    flow[1] = [-k * r * r / inertia, -(b + c * r * r) / inertia, 1.0 / inertia, 0.0]
    flow[2, 2] = -drive
    flow[3] = [cell * k * r, cell * c * r, 0.0, -cell]
    enter = np.array([[0.0], [0.0], [drive], [0.0]])
    step, effect, *_ = signal.cont2discrete((flow, enter, np.eye(4), np.zeros((4, 1))), PERIOD)
    waiting = DELAY_TICKS + extra_delay
    size = 6 + waiting
    matrix = np.zeros((size, size))
    matrix[:4, :4] = step
    matrix[:4, size - 1] = effect[:, 0]
    matrix[4, 0] = 1.0
    gain = settings.integral * PERIOD
    matrix[5, 5], matrix[5, 3] = 1.0, gain
    torque = np.zeros(size)
    torque[3] = -r * (settings.proportional + gain)
    torque[5] = -r
    torque[0] = -settings.rate_damping / PERIOD
    torque[4] = settings.rate_damping / PERIOD
    matrix[6] = factor * torque
    for n in range(1, waiting):
        matrix[6 + n, 5 + n] = 1.0
    return matrix


def spectral_radius(matrix: Array) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def test_the_shipped_loop_is_stable_in_the_time_domain() -> None:
    assert spectral_radius(closed_loop(1.0)) < 1.0


@pytest.mark.parametrize("length", [0.9, 1.2, 1.7])
@pytest.mark.parametrize("integral", [SETTINGS.integral, 5.0 * SETTINGS.integral])
def test_the_gain_margin_is_where_the_sampled_loop_turns_unstable(
    length: float, integral: float
) -> None:
    settings = SETTINGS.model_copy(update={"integral": integral})
    found = margins(settings, length)
    edge = 10.0 ** (found.gain_db / 20.0)
    inner, outer = (0.995, 1.005) if edge > 1.0 else (1.005, 0.995)
    assert spectral_radius(closed_loop(1.0 + (edge - 1.0) * inner, 0, length, settings)) < 1.0
    assert spectral_radius(closed_loop(1.0 + (edge - 1.0) * outer, 0, length, settings)) > 1.0


def test_more_delay_than_the_phase_margin_covers_is_unstable() -> None:
    found = margins()
    spare = found.phase_deg / 360.0 / found.crossover_hz / PERIOD
    assert spectral_radius(closed_loop(1.0, extra_delay=int(spare))) < 1.0
    assert spectral_radius(closed_loop(1.0, extra_delay=int(spare) + 2)) > 1.0


@pytest.mark.parametrize("length", [0.05, 0.1, 0.2])
def test_a_loop_is_judged_by_its_poles_and_not_by_where_it_falls_below_one(length: float) -> None:
    """Upward crossings were not looked at: this was 19 to 26 dB and 37 to 110 degrees."""
    settings = SETTINGS.model_copy(
        update={"proportional": 19.115, "rate_damping": 0.377, "integral": 166.7}
    )
    found = tension_loop_margins(
        ROBOT.drive_trains[0],
        settings,
        0.002,
        cable_length=length,
        current_loop_hz=CURRENT_HZ,
        cell_bandwidth_hz=CELL_HZ,
    )
    assert not found.stable
    assert not found.meet(settings)
    assert found.gain_db == found.reduction_db == found.phase_deg == -math.inf


@pytest.mark.parametrize("gain", [0.6, 1.0, 5.0])
def test_a_gain_that_must_not_fall_has_a_margin_downwards(gain: float) -> None:
    """K (s + 1)^2 / s^3 is stable for K over one half, and for every larger one."""
    frequency = np.geomspace(1e-4, 1e3, 20_000)
    s = 2j * np.pi * frequency
    found = margins_of(np.asarray(gain * (s + 1.0) ** 2 / s**3), frequency)
    assert found.reduction_db == pytest.approx(20.0 * math.log10(gain / 0.5), abs=0.02)
    assert found.gain_db > 60.0
    assert found.least_gain_db == found.reduction_db


def test_upward_crossings_count_for_the_phase() -> None:
    """A resonance at 10 Hz that rises over one at 9.5 Hz, 20 degrees from the edge."""
    frequency = np.linspace(1.0, 20.0, 4000)
    size = np.where((frequency > 9.5) & (frequency < 10.5), 2.0, 0.5)
    angle = np.where(frequency < 10.0, -160.0, -90.0)
    found = margins_of(size * np.exp(1j * np.radians(angle)), frequency)
    assert found.phase_deg == pytest.approx(20.0)


def test_a_loop_without_an_integral_may_be_stable() -> None:
    settings = SETTINGS.model_copy(update={"integral": 0.0})
    assert margins(settings).meet(settings)


def test_delay_costs_margin() -> None:
    phases = [margins(delay=ticks).phase_deg for ticks in (1, 2, 3)]
    assert phases == sorted(phases, reverse=True)


def test_the_paper_gain_without_damping_has_no_margin() -> None:
    """Eq. (9) alone, at the gain its half a per cent would need."""
    bare = {"proportional": 199.0, "integral": 0.0, "rate_damping": 0.0}
    paper = margins(SETTINGS.model_copy(update=bare))
    assert paper.gain_db < 0.0 or paper.phase_deg < 5.0


def reachable_lengths() -> tuple[float, float]:
    """Shortest and longest cable over the corners, faces and middle of the box."""
    kinematics, box = Kinematics(ROBOT.geometry), ROBOT.workspace
    level = np.array([1.0, 0.0, 0.0, 0.0])
    lengths = []
    for place in product(*[np.linspace(*side, 3) for side in (box.x, box.y, box.z)]):
        kinematics.evaluate(np.array(place), level)
        lengths += [kinematics.lengths.min(), kinematics.lengths.max()]
    return min(lengths), max(lengths)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_the_shipped_loop_meets_its_own_floors_over_the_workspace(share: float) -> None:
    shortest, longest = reachable_lengths()
    found = margins(length=shortest + share * (longest - shortest))
    assert found.gain_db >= SETTINGS.gain_margin_db
    assert found.phase_deg >= SETTINGS.phase_margin_deg
