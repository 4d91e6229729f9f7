"""From process image to measurements: drum rates over gaps, freshness, and the tare."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.process_image import NEVER, ProcessImage
from tonus.runtime.control.sensing import Sensing

CONFIG = load("config/can.yaml")[0]
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
PERIOD, FRESHNESS = CONTROL.rates.period, CONTROL.freshness


def quiet() -> ProcessImage:
    image = ProcessImage(8)
    image.axes["age"], image.cells["age"] = 0, 0
    return image


def test_rate_is_the_difference_of_consecutive_samples() -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    for tick in range(5):
        image.axes["angle"] = 0.002 * tick * np.arange(8)
        sensing.step(image, tick)
    np.testing.assert_allclose(sensing.rate, 2.0 * np.arange(8), rtol=1e-12)


def test_the_first_sample_makes_no_rate() -> None:
    sensing, image = Sensing(ROBOT, CONTROL), ProcessImage(8)
    sensing.step(image, 0)
    image.axes["age"], image.axes["angle"] = 0, 40.0
    sensing.step(image, 1)
    np.testing.assert_array_equal(sensing.rate, 0.0)


def test_a_gap_is_bridged_by_the_time_between_the_samples() -> None:
    """Three lost ticks hold the rate; the next sample spreads its step over all of them."""
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    for tick in range(3):
        image.axes["angle"] = 0.001 * tick
        sensing.step(image, tick)
    for lost in range(1, 4):
        image.axes["age"] = lost
        sensing.step(image, 2 + lost)
        np.testing.assert_allclose(sensing.rate, 1.0, rtol=1e-9)
    image.axes["age"], image.axes["angle"] = 0, 0.010
    sensing.step(image, 6)
    np.testing.assert_allclose(sensing.rate, 0.008 / (4 * PERIOD), rtol=1e-9)


def test_skipped_ticks_count_as_time() -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    sensing.step(image, 10)
    image.axes["angle"] = 0.006
    sensing.step(image, 13)
    np.testing.assert_allclose(sensing.rate, 2.0, rtol=1e-12)


def test_a_cable_is_usable_while_both_its_devices_are_fresh() -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    limit = FRESHNESS.measurement_ticks
    image.axes["age"][1], image.cells["age"][2] = limit + 1, limit + 1
    image.axes["age"][3] = image.cells["age"][3] = limit
    image.cells["age"][8] = NEVER
    sensing.step(image, 0)
    np.testing.assert_array_equal(~sensing.usable, np.isin(np.arange(8), [1, 2]))


@pytest.mark.parametrize("row", [0, 7])
def test_who_is_lost_is_named(row: int) -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    assert (sensing.lost_axis(), sensing.lost_cell()) == (-1, -1)
    for tick in range(FRESHNESS.stale_stop_ticks):
        image.axes["age"][row] = image.cells["age"][row + 1] = tick + 1
        sensing.step(image, tick)
    assert (sensing.lost_axis(), sensing.lost_cell()) == (-1, -1)
    sensing.step(image, FRESHNESS.stale_stop_ticks)
    assert (sensing.lost_axis(), sensing.lost_cell()) == (row, row + 1)


@pytest.mark.parametrize(("late", "lost"), [(0, False), (1, True)])
def test_a_device_that_is_late_by_less_than_the_freshness_is_not_lost(
    late: int, lost: bool
) -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    image.axes["age"][4] = FRESHNESS.measurement_ticks + late
    for tick in range(2 * FRESHNESS.stale_stop_ticks):
        sensing.step(image, tick)
    assert sensing.lost_axis() == (4 if lost else -1)


def test_a_stall_of_the_host_loses_nobody() -> None:
    """Every answer is old after it, but nobody was asked meanwhile."""
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    sensing.step(image, 0)
    image.axes["age"], image.cells["age"] = 200, 200
    sensing.step(image, 200)
    assert not sensing.usable.any()
    assert sensing.present.all()
    assert (sensing.lost_axis(), sensing.lost_cell()) == (-1, -1)


@pytest.mark.parametrize("angle", [5.0, -2.7e5, np.nan, np.inf])
def test_an_impossible_angle_is_no_sample(angle: float) -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    sensing.step(image, 0)
    image.axes["angle"][3] = angle
    sensing.step(image, 1)
    assert not sensing.usable[3]
    assert sensing.usable.sum() == 7
    assert sensing.angle[3] == 0.0
    assert sensing.rate[3] == 0.0
    image.axes["angle"][3] = 0.002
    sensing.step(image, 2)
    assert sensing.usable.all()
    assert sensing.rate[3] == pytest.approx(1.0)


@pytest.mark.parametrize("force", [1e4, -1e4, np.nan, np.inf])
def test_an_impossible_force_is_no_sample(force: float) -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    sensing.step(image, 0)
    image.cells["force"][2] = force
    sensing.step(image, 1)
    assert not sensing.usable[2]
    assert np.isfinite(sensing.force).all()
    assert np.isfinite(sensing.filter.value).all()


def test_the_tare_is_the_mean_of_fresh_readings() -> None:
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    offset = np.linspace(-1.0, 1.0, 9)
    for n in range(10):
        image.cells["force"] = offset + (0.1 if n % 2 else -0.1)
        sensing.collect_tare(image)
    image.cells["force"], image.cells["age"][4] = 99.0, FRESHNESS.measurement_ticks + 1
    sensing.collect_tare(image)
    assert sensing.tare_time == pytest.approx(10 * PERIOD)
    assert sensing.apply_tare(None) == 10
    np.testing.assert_allclose(sensing.tare, offset, atol=1e-12)
    image.cells["force"] = offset + 3.0
    for tick in range(200):
        sensing.step(image, tick)
    np.testing.assert_allclose(sensing.tension, 3.0, atol=1e-12)
    assert sensing.contact == pytest.approx(3.0, abs=1e-6)


def test_the_time_between_two_syncs_counts_and_not_the_tick() -> None:
    """A drum at 3 rad/s, sampled by SYNCs up to 0.7 ms late; too close ones say nothing."""
    sensing, image = Sensing(ROBOT, CONTROL), quiet()
    for tick, late in enumerate((0.0, 0.7, 0.3, 0.0, 0.5, 0.6)):
        at = (tick + late) * PERIOD
        image.axes["angle"], image.axes["sampled_ns"] = 3.0 * at, 1_000_000 + round(at * 1e9)
        sensing.step(image, tick)
        if tick:
            np.testing.assert_allclose(sensing.rate, 3.0, rtol=1e-6)
    image.axes["angle"] += 0.0001
    image.axes["sampled_ns"] += 100_000
    sensing.step(image, 6)
    np.testing.assert_allclose(sensing.rate, 3.0, rtol=1e-6)
