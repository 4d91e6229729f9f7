"""Measurements at their limits themselves: rates and times of samples, forces, silence, tare."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from tonus.config import load
from tonus.drivers.process_image import NEVER, AxisState, ProcessImage
from tonus.runtime.control.sensing import DEFECT, FAULTED, NOT_ENABLED, SILENT, Sensing

CONFIG = load("config/can.yaml")[0]
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
N, CELLS = ROBOT.cables, ROBOT.cells
PERIOD, PERIOD_NS = CONTROL.rates.period, CONTROL.rates.period_ns
FRESH = CONTROL.freshness.measurement_ticks
STALE = CONTROL.freshness.stale_stop_ticks
FASTEST = CONTROL.filters.plausible_speed * ROBOT.motor_speed / ROBOT.gear_ratio
"""rad/s (n,)"""
STRONGEST = CONTROL.filters.plausible_force


class Devices:
    """That answer in every tick, with drums and cables at rest."""

    def __init__(self) -> None:
        self.sensing, self.image, self.tick = Sensing(ROBOT, CONTROL), ProcessImage(N), 0
        self.image.axes["age"] = self.image.cells["age"] = 0

    def step(self, ticks: int = 1) -> Devices:
        for _ in range(ticks):
            self.sensing.step(self.image, self.tick)
            self.tick += 1
        return self


@pytest.fixture
def devices() -> Devices:
    return Devices()


# --- rates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, N - 1])
def test_a_step_that_no_motor_can_make(devices: Devices, sign: float, axis: int) -> None:
    devices.step()
    step = sign * FASTEST[axis] * PERIOD
    devices.image.axes["angle"][axis] = 0.999 * step
    devices.step()
    assert devices.sensing.rate[axis] == pytest.approx(sign * 0.999 * FASTEST[axis])
    assert devices.sensing.usable.all()
    devices.image.axes["angle"][axis] += 1.001 * step
    devices.step()
    assert devices.sensing.implausible_axes.tolist() == [each == axis for each in range(N)]
    assert devices.sensing.usable.tolist() == [each != axis for each in range(N)]
    assert devices.sensing.angle[axis] == pytest.approx(0.999 * step)
    assert devices.sensing.rate[axis] == pytest.approx(sign * 0.999 * FASTEST[axis])
    devices.step()
    assert devices.sensing.usable.all(), "in two ticks it can"


def test_a_sample_counts_once(devices: Devices) -> None:
    """Its age grows with the ticks; a sample of never is none, and keeps what there was."""
    devices.step()
    devices.image.axes["angle"] = 0.002
    devices.step()
    devices.image.axes["angle"] = 5.0
    for age in (1, 2, 3):
        devices.image.axes["age"] = age
        devices.step()
    devices.image.axes["age"] = NEVER
    devices.step()
    assert devices.sensing.angle == pytest.approx(0.002)
    assert devices.sensing.rate == pytest.approx(0.002 / PERIOD)
    assert not devices.sensing.implausible_axes.any()


def test_an_older_sample_than_the_last_is_none(devices: Devices) -> None:
    devices.step(5)
    devices.image.axes["angle"], devices.image.axes["age"] = 0.004, 2
    devices.step()
    assert not devices.sensing.angle.any()
    devices.image.axes["age"] = 1
    devices.step()
    assert devices.sensing.rate == pytest.approx(0.004 / PERIOD), "of the tick after the last one"


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_first_sample_that_is_no_number(bad: float) -> None:
    devices = Devices()
    devices.image.axes["angle"][2] = bad
    devices.step()
    assert devices.sensing.implausible_axes.tolist() == [axis == 2 for axis in range(N)]
    devices.image.axes["angle"][2] = 1e6
    devices.step()
    assert not devices.sensing.implausible_axes.any(), "the first good one may be anywhere"
    assert devices.sensing.angle[2] == 1e6
    assert devices.sensing.rate[2] == 0.0


@pytest.mark.parametrize(
    ("late", "interval", "rate"), [(-0.5, 0.5, 2.0), (0.25, 1.25, 0.8), (-0.75, 0.25, 4.0)]
)
def test_the_time_between_two_samples_is_that_of_their_syncs(
    devices: Devices, late: float, interval: float, rate: float
) -> None:
    """In periods; the angle turns by one in each."""
    axes = devices.image.axes
    axes["sampled_ns"] = 7 * PERIOD_NS
    devices.step()
    axes["sampled_ns"] += PERIOD_NS + round(late * PERIOD_NS)
    axes["angle"] = PERIOD
    devices.step()
    assert devices.sensing.interval == pytest.approx(interval * PERIOD)
    assert devices.sensing.rate == pytest.approx(rate)


def test_samples_that_are_too_close_tell_no_rate_but_where_the_drum_is(devices: Devices) -> None:
    axes = devices.image.axes
    axes["sampled_ns"] = 7 * PERIOD_NS
    devices.step()
    axes["sampled_ns"] += round(0.2 * PERIOD_NS)
    axes["angle"] = 0.001
    devices.step()
    assert devices.sensing.angle == pytest.approx(0.001)
    assert not devices.sensing.rate.any()
    assert not devices.sensing.implausible_axes.any()
    axes["sampled_ns"] += round(0.1 * PERIOD_NS)
    axes["angle"] += 0.26 * PERIOD * FASTEST
    devices.step()
    assert devices.sensing.implausible_axes.all(), "beyond what it could turn in a quarter"


@pytest.mark.parametrize("first", [0, 9 * PERIOD_NS])
def test_where_a_time_is_not_known_ticks_count(devices: Devices, first: int) -> None:
    axes = devices.image.axes
    axes["sampled_ns"] = first
    devices.step()
    axes["sampled_ns"], axes["angle"] = 9 * PERIOD_NS - first, 0.003
    devices.tick += 2
    devices.step()
    assert devices.sensing.interval == pytest.approx(3 * PERIOD)
    assert devices.sensing.rate == pytest.approx(0.001 / PERIOD)


# --- forces --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_that_no_cable_bears(devices: Devices, sign: float) -> None:
    """At its limit it is one; beyond, the last good one stays and its cable is not usable."""
    devices.image.cells["force"][[1, N]] = sign * STRONGEST
    devices.step()
    assert devices.sensing.force[[1, N]].tolist() == [sign * STRONGEST] * 2
    assert not devices.sensing.implausible_cells.any()
    devices.image.cells["force"][[1, N]] = sign * (STRONGEST + 1.0)
    devices.step()
    assert np.flatnonzero(devices.sensing.implausible_cells).tolist() == [1, N]
    assert devices.sensing.force[[1, N]].tolist() == [sign * STRONGEST] * 2
    assert np.flatnonzero(~devices.sensing.usable).tolist() == [1]


def test_the_offset_is_taken_off_before_it_is_judged(devices: Devices) -> None:
    assert devices.sensing.apply_tare([3.0] * CELLS) == 0
    devices.image.cells["force"] = STRONGEST + 2.0
    devices.step()
    assert devices.sensing.force.tolist() == [STRONGEST - 1.0] * CELLS
    assert devices.sensing.tension.tolist() == [STRONGEST - 1.0] * N


# --- silence -------------------------------------------------------------------------------------


def test_how_old_both_samples_of_a_cable_may_be(devices: Devices) -> None:
    devices.image.axes["age"][[0, 1]] = FRESH, FRESH + 1
    devices.image.cells["age"][[2, 3]] = FRESH, FRESH + 1
    devices.step()
    assert np.flatnonzero(~devices.sensing.usable).tolist() == [1, 3]
    assert devices.sensing.present.all()


def test_how_long_a_device_may_be_silent(devices: Devices) -> None:
    """A cable keeps its place for just as long as its devices are not lost; the contact cell has
    none."""
    devices.step()
    for silent in range(1, STALE + 2):
        devices.image.axes["age"][2] = silent
        devices.image.cells["age"][[5, N]] = silent
        devices.step()
        lost = silent > STALE
        assert np.flatnonzero(~devices.sensing.present).tolist() == ([2, 5] if lost else [])
        assert devices.sensing.lost_axis() == (2 if lost else -1)
        assert devices.sensing.lost_cell() == (5 if lost else -1)
    assert devices.sensing.lost_axis(2) == 2
    assert devices.sensing.lost_axis(3) == -1
    assert devices.sensing.lost_cell(6) == N
    devices.image.axes["age"] = devices.image.cells["age"] = 0
    devices.step()
    assert devices.sensing.present.all()
    assert (devices.sensing.lost_axis(), devices.sensing.lost_cell()) == (-1, -1)


def test_a_sample_that_does_not_grow_older_is_new(devices: Devices) -> None:
    """Always as late as may be; one that is later each time is none."""
    devices.image.axes["age"][1] = FRESH
    devices.step(3 * STALE)
    assert devices.sensing.present.all()
    devices.image.axes["age"][1] = FRESH + 1
    devices.step(STALE)
    assert devices.sensing.present.all()
    devices.step()
    assert np.flatnonzero(~devices.sensing.present).tolist() == [1]


def test_impossible_values_are_as_silence(devices: Devices) -> None:
    devices.image.axes["angle"][4] = np.nan
    devices.image.cells["force"][6] = np.nan
    devices.step(STALE)
    assert devices.sensing.present.all()
    devices.step()
    assert np.flatnonzero(~devices.sensing.present).tolist() == [4, 6]
    assert (devices.sensing.lost_axis(), devices.sensing.lost_cell()) == (4, 6)


# --- tare ----------------------------------------------------------------------------------------


def test_what_counts_for_the_tare(devices: Devices) -> None:
    """Readings as old as may be do; older ones, and impossible ones, do not."""
    sensing, image = devices.sensing, devices.image
    image.cells["force"] = 2.0
    image.cells["age"][3] = FRESH
    sensing.collect_tare(image)
    assert sensing.tare_time == pytest.approx(PERIOD)
    image.cells["age"][3] = FRESH + 1
    sensing.collect_tare(image)
    image.cells["age"][3] = 0
    sensing.implausible_cells[8] = True
    sensing.collect_tare(image)
    assert sensing.tare_time == pytest.approx(PERIOD)
    sensing.implausible_cells[8] = False
    image.cells["force"] = 3.0
    sensing.collect_tare(image)
    assert sensing.apply_tare(None) == 2
    assert sensing.tare.tolist() == [2.5] * CELLS
    assert sensing.tare_time == 0.0


def test_a_tare_begins_the_forces_anew(devices: Devices) -> None:
    devices.image.cells["force"] = 50.0
    devices.step(100)
    assert devices.sensing.contact == pytest.approx(50.0, abs=1.0)
    devices.sensing.apply_tare(None)
    assert devices.sensing.tare.tolist() == [0.0] * CELLS, "no reading was collected"
    assert not devices.sensing.force.any()
    assert devices.sensing.contact == 0.0
    devices.sensing.collect_tare(devices.image)
    devices.sensing.apply_tare(None)
    devices.sensing.collect_tare(devices.image)
    assert devices.sensing.apply_tare([1.0] * CELLS) == 1
    assert devices.sensing.tare.tolist() == [1.0] * CELLS, "what is stated comes first"
    devices.sensing.collect_tare(devices.image)
    devices.sensing.apply_tare(None)
    assert devices.sensing.tare.tolist() == [50.0] * CELLS, "of the readings since"


# --- what is told of a sample --------------------------------------------------------------------


def test_the_fastest_that_a_motor_can_turn_is_a_sample(devices: Devices) -> None:
    """A thousand ticks are a second to the last bit."""
    for angle, beyond in ((FASTEST, False), (np.nextafter(FASTEST, np.inf), True)):
        devices = Devices().step()
        devices.tick += 999
        devices.image.axes["angle"] = angle
        devices.step()
        assert devices.sensing.implausible_axes.tolist() == [beyond] * N


def test_a_repeated_sample_changes_no_interval(devices: Devices) -> None:
    devices.step(2)
    devices.image.axes["age"], devices.image.axes["angle"] = 1, 3.0
    devices.step()
    assert devices.sensing.interval == pytest.approx(PERIOD)
    assert not devices.sensing.implausible_axes.any()


def test_where_no_sample_comes_none_is_impossible(devices: Devices) -> None:
    devices.step()
    devices.image.axes["angle"][3] = 1e6
    devices.step()
    assert devices.sensing.implausible_axes[3]
    devices.image.axes["age"][3] = NEVER
    devices.step()
    assert not devices.sensing.implausible_axes.any()


def test_a_cable_is_reeled_in_by_its_drum(devices: Devices) -> None:
    devices.step()
    devices.image.axes["angle"] = PERIOD * np.linspace(-2.0, 3.0, N)
    devices.step()
    expected = ROBOT.drum_radius * np.linspace(-2.0, 3.0, N)
    assert devices.sensing.winding == pytest.approx(expected)


def test_a_cable_gets_torque_while_it_is_both_usable_and_present(devices: Devices) -> None:
    """Too old a sample is still present; a good one after many impossible ones is not yet."""
    devices.image.axes["age"][1] = FRESH + 1
    devices.image.axes["angle"][4] = np.nan
    devices.step(STALE)
    assert np.flatnonzero(~devices.sensing.usable).tolist() == [1, 4]
    assert devices.sensing.present.all()
    assert np.flatnonzero(~devices.sensing.sound).tolist() == [1, 4]
    devices.image.axes["age"][[1, 4]] = 0, 1
    devices.image.axes["angle"][4] = 0.0
    devices.step()
    assert devices.sensing.usable.all()
    assert np.flatnonzero(~devices.sensing.present).tolist() == [4]
    assert np.flatnonzero(~devices.sensing.sound).tolist() == [4]
    devices.image.axes["age"][4] = 0
    assert devices.step().sensing.sound.all()


def test_forces_are_filtered_at_the_rate_of_the_ticks(devices: Devices) -> None:
    """Of the paper's filter by SciPy, with the cables apart from the contact port."""
    random, readings = np.random.default_rng(5), []
    b, a = butter(2, CONTROL.filters.force_cutoff_hz, fs=1.0 / PERIOD)
    for _ in range(40):
        devices.image.cells["force"] = random.normal(np.arange(CELLS), 1.0)
        readings.append(devices.image.cells["force"].copy())
        devices.step()
        expected = lfilter(b, a, np.array(readings), axis=0)[-1]
        assert devices.sensing.filtered == pytest.approx(expected[:N], rel=1e-9, abs=1e-12)
        assert devices.sensing.contact == pytest.approx(expected[N], rel=1e-9)


# --- alarms --------------------------------------------------------------------------------------


@pytest.fixture
def enabled(devices: Devices) -> Devices:
    assert devices.sensing.alarm == 0, "before the first tick"
    devices.image.axes["state"] = int(AxisState.OPERATION_ENABLED)
    assert devices.step().sensing.alarm == 0
    return devices


@pytest.mark.parametrize("state", AxisState)
@pytest.mark.parametrize("axis", [0, N - 1])
def test_a_drive_that_is_not_enabled_or_in_a_fault_is_an_alarm(
    enabled: Devices, axis: int, state: AxisState
) -> None:
    """A fault at any age; not to be enabled, of a fresh statusword alone."""
    faulted = state in (AxisState.FAULT, AxisState.FAULT_REACTION_ACTIVE)
    disabled = state is not AxisState.OPERATION_ENABLED
    enabled.image.axes["state"][axis] = int(state)
    for age in (0, FRESH, FRESH + 1):
        enabled.image.axes["age"][axis] = age
        expected = (FAULTED if faulted else 0) | (NOT_ENABLED if disabled and age <= FRESH else 0)
        assert enabled.step().sensing.alarm == expected


@pytest.mark.parametrize("cell", [0, N - 1, N])
def test_a_cell_that_reports_a_defect_is_an_alarm(enabled: Devices, cell: int) -> None:
    for status in (1, 2, 128):
        enabled.image.cells["status"][cell] = status
        assert enabled.step().sensing.alarm == DEFECT
    enabled.image.cells["status"][cell] = 0
    assert enabled.step().sensing.alarm == 0


@pytest.mark.parametrize(
    ("devices_of", "which"), [("axes", 0), ("axes", N - 1), ("cells", 0), ("cells", N)]
)
def test_a_device_that_is_too_long_silent_is_an_alarm(
    enabled: Devices, devices_of: str, which: int
) -> None:
    for silent in range(1, STALE + 3):
        getattr(enabled.image, devices_of)["age"][which] = silent
        assert enabled.step().sensing.alarm == (SILENT if silent > STALE else 0)
    getattr(enabled.image, devices_of)["age"][which] = 0
    assert enabled.step().sensing.alarm == 0
