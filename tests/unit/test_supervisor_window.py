"""What the supervisor takes from its window of looks, and how far back it compares with records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.supervisor_setup import MS, STRICT, N, Stage, claim
from tonus.config import Config, load
from tonus.runtime.supervisor.observation import Observation

BASE = 1000
"""ms at which a test begins"""


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


@pytest.fixture
def stage(config: Config) -> Stage:
    return Stage(config)


def window_ms(config: Config) -> int:
    assert config.supervisor is not None
    return round(config.supervisor.window_ms)


def test_forces_are_those_of_the_cells_less_the_tare(stage: Stage) -> None:
    tare = 1.0 + 0.5 * np.arange(N + 1)
    for k in range(BASE, BASE + 30):
        stage.tick(k * MS, newton=45.0, metre=0.0, force=45.0)
        found = stage.observe(k * MS, stage.heard, [claim(at_ms=k, tare=tare)])
    assert found.tension == pytest.approx(45.0 - tare[found.axes])
    assert found.contact == pytest.approx(45.0 - tare[N])
    assert found.unexplained == pytest.approx(tare[found.axes], abs=0.5)
    assert found.torque == pytest.approx(np.full(N, 45.0), abs=0.2)


def test_without_a_record_no_tare_is_taken_off(stage: Stage) -> None:
    for k in range(BASE, BASE + 30):
        stage.tick(k * MS, newton=45.0, metre=0.0, force=45.0)
        found = stage.observe(k * MS, stage.heard, [])
    assert found.unexplained == pytest.approx(np.zeros(N), abs=0.5)
    assert np.isnan(found.tension).all()


def test_ages_are_from_when_it_was_received(stage: Stage) -> None:
    stage.tick(BASE * MS, newton=45.0, metre=0.0, force=45.0)
    found = stage.observe((BASE + 3) * MS, stage.heard, [claim()])
    for ages in (found.torque_age, found.measured_age, found.cell_age):
        assert ages == pytest.approx(np.full(N, 3.0))
    assert found.contact_age == pytest.approx(3.0)


@pytest.mark.parametrize("rows", [(2,), (2, 3)])
def test_how_long_no_drive_of_a_channel_has_answered(stage: Stage, rows: tuple[int, ...]) -> None:
    axes = stage.wiring.axes
    assert {axis.channel for axis in axes[2:4]} == {axes[2].channel}
    for k in (BASE, BASE + 3):
        before = {each: stage.heard[axes[each].channel, axes[each].received] for each in rows}
        kept = {each: (heard.at_ns, heard.count) for each, heard in before.items()}
        stage.tick(k * MS, newton=45.0, metre=0.0, force=45.0)
        if k > BASE:
            for each, heard in before.items():
                heard.at_ns, heard.count = kept[each]
    found = stage.observe((BASE + 3) * MS, stage.heard, [claim()])
    wanted = np.zeros(N)
    wanted[list(rows)] = 3.0
    assert found.measured_age == pytest.approx(wanted)
    assert found.channel_age == pytest.approx(wanted if rows == (2, 3) else np.zeros(N))


def test_the_newest_of_several_records_counts(stage: Stage) -> None:
    records = [claim(at_ms=1.0), claim(at_ms=2.0), claim(at_ms=3.0)]
    found = stage.observe(BASE * MS, stage.heard, records)
    assert found.claims == records
    assert found.claim is records[-1]


def test_a_rate_is_known_in_the_third_look(stage: Stage) -> None:
    for look in range(3):
        at = BASE + 2 * look
        for tick in (at - 1, at):
            stage.tick(tick * MS, newton=45.0, metre=0.2e-3 * (tick - BASE), force=45.0)
        found = stage.observe(at * MS, stage.heard, [claim(at_ms=at)])
        assert np.isnan(found.rate).all() == (look < 2)
    assert found.rate == pytest.approx(0.2, rel=0.05)


def test_a_mean_is_of_the_window_and_of_nothing_before(config: Config, stage: Stage) -> None:
    """Torques that step up at a look: with the window past it their mean is what they are."""
    length, step = window_ms(config), BASE + 60
    means = {}
    for k in range(BASE, step + length + 1):
        stage.tick(k * MS, newton=45.0 if k <= step else 90.0, metre=0.0, force=45.0)
        if (k - step) % 2 == 0:
            found = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
            means[k] = found.mean_torque
            assert np.isnan(means[k]).all() == (k - BASE < length)
    assert means[step] == pytest.approx(45.0, abs=0.3)
    assert means[step + length] == pytest.approx(90.0, abs=0.3)
    late = 45.0 * (1.0 + (length - 2) / length)
    assert means[step + length - 2] == pytest.approx(late, abs=0.3)


def test_a_strong_acceleration_is_explained(stage: Stage) -> None:
    acceleration, force, axis = 8.0, 45.0, stage.wiring.axes[0]
    for k in range(40):
        t = k * 1e-3
        rate = acceleration * t
        pull = force + axis.mass * acceleration + axis.damping * rate
        stage.tick((BASE + k) * MS, newton=pull, metre=0.5 * acceleration * t * t, force=force)
        if k % 2 == 0:
            found = stage.observe((BASE + k) * MS, stage.heard, [claim(at_ms=BASE + k)])
    assert np.abs(found.unexplained).max() < 3.0


def test_what_a_drums_change_of_motion_takes(stage: Stage) -> None:
    """Whatever it is sent, and its cell says."""
    acceleration, axis = 8.0, stage.wiring.axes[0]
    for k in range(40):
        t = k * 1e-3
        stage.tick((BASE + k) * MS, newton=-20.0, metre=0.5 * acceleration * t * t, force=300.0)
        if k % 2 == 0:
            found = stage.observe((BASE + k) * MS, stage.heard, [claim(at_ms=BASE + k)])
    takes = axis.mass * acceleration + axis.damping * acceleration * t
    assert found.motion == pytest.approx(takes, abs=3.0)
    assert found.most_torque == pytest.approx(-20.0, abs=0.3)


def test_the_largest_torque_of_the_window(config: Config, stage: Stage) -> None:
    """Also of a single tick between two looks, until the window is past it."""
    length, at = window_ms(config), BASE + 41
    most = {}
    for k in range(BASE, at + 2 * length):
        stage.tick(k * MS, newton=90.0 if k == at else 45.0, metre=0.0, force=45.0)
        if (k - BASE) % 2 == 0:
            most[k] = stage.observe(k * MS, stage.heard, [claim(at_ms=k)]).most_torque
    for k, found in most.items():
        beside = k < at or k > at + length + 2
        assert found == pytest.approx(45.0 if beside else 90.0, abs=0.3), k - at


# --- records -------------------------------------------------------------------------------------


class Logged:
    """One look a tick; what axis 2 is sent and what is recorded of it, per mille."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.tick, self.late = stage, BASE, False

    def look(self, sent: list[int], recorded: list[int]) -> bool:
        self.tick += 1
        stage, axes = self.stage, self.stage.wiring.axes
        for number, axis in enumerate(axes):
            for mille in sent if number == 2 else recorded:
                word = (mille & 0xFFFF) << axis.torque.shift
                stage.heard[axis.channel, axis.sent].take([word], self.tick * MS)
        records = [
            claim(
                at_ms=float(self.tick),
                torque=np.array([mille / each.per_newton_metre for each in axes]),
            )
            for mille in recorded
        ]
        found = stage.observe(self.tick * MS, stage.heard, records)
        others = np.arange(N) != 2
        assert not found.unlogged[others].any()
        assert not found.late[others].any()
        self.late = bool(found.late[2])
        return bool(found.unlogged[2])


@pytest.mark.parametrize("more", [0, 1])
def test_how_far_back_a_torque_may_have_been_recorded(
    config: Config, stage: Stage, more: int
) -> None:
    """``logged_ticks`` before those of the look before."""
    assert config.supervisor is not None
    logged, late = Logged(stage), config.supervisor.logged_ticks + more
    assert not logged.look([500], [500])
    for look in range(1, late + 1):
        assert not logged.look([500 if look == late else 100], [100])
    assert logged.look([100], [100]) is (more > 0)


@pytest.mark.parametrize(("before", "late"), [(22, True), (23, False)])
@pytest.mark.parametrize("off", [0, 1, 2])
def test_a_torque_of_a_record_of_long_ago_is_late(
    config: Config, stage: Stage, before: int, late: bool, off: int
) -> None:
    """As long before those that are compared as a drive waits for the heartbeat. One that acts is
    compared in the look in which it does, with the records until then."""
    assert config.supervisor is not None
    assert config.supervisor.timeout_ms == 22
    logged, looks = Logged(stage), config.supervisor.logged_ticks + before
    assert not logged.look([500], [500])
    for _ in range(1, looks):
        assert not logged.look([100], [100])
        assert not logged.late
    assert logged.look([500 + off], [100])
    assert logged.late is (off < 2)
    assert logged.look([100], [100])
    assert logged.late is (late and off < 2)


def test_a_torque_that_acts_at_once_is_compared_in_the_next_look(stage: Stage) -> None:
    """It may not be recorded yet in its own. Where none was sent the last one is."""
    stage.wiring.axes[:] = [replace(each, sync=0) for each in stage.wiring.axes]
    logged = Logged(stage)
    for _ in range(9):
        assert not logged.look([100], [100])
    assert not logged.look([500], [100])
    assert logged.look([], [100])
    assert logged.look([], [100])
    assert not logged.look([100], [100])


@pytest.mark.parametrize(("off", "broken"), [(-2, True), (-1, False), (1, False), (2, True)])
def test_how_far_a_torque_may_be_from_its_record(stage: Stage, off: int, broken: bool) -> None:
    logged = Logged(stage)
    for _ in range(9):
        assert not logged.look([100], [100])
    logged.look([100 + off], [100])
    assert logged.look([100], [100]) is broken


@pytest.mark.parametrize("mille", [-1, 0, 1])
def test_a_recorded_torque_that_is_no_number_counts_as_none(stage: Stage, mille: int) -> None:
    for tick in range(BASE, BASE + 3):
        for axis in stage.wiring.axes:
            word = (mille & 0xFFFF) << axis.torque.shift
            stage.heard[axis.channel, axis.sent].take([word], tick * MS)
        said = claim(at_ms=float(tick), torque=np.full(N, np.nan))
        found = stage.observe(tick * MS, stage.heard, [said])
        assert not found.unlogged.any()


def test_a_drive_that_alone_knows_its_scale_is_not_compared(config: Config) -> None:
    stage = Stage(config)
    stage.wiring.axes[:] = [replace(each, newton=None) for each in stage.wiring.axes]
    assert config.supervisor is not None
    observe = type(stage.observe)(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    found: Observation | None = None
    for k in range(5):
        for axis in stage.wiring.axes:
            stage.heard[axis.channel, axis.sent].take([100 << axis.torque.shift], k * MS)
        found = observe(k * MS, stage.heard, [claim(at_ms=k)])
    assert found is not None
    assert not found.unlogged.any()


def test_a_window_is_of_two_looks_at_least(config: Config) -> None:
    """However short it is stated."""
    assert config.supervisor is not None
    stage, step = Stage(config), BASE + 40
    short = config.supervisor.model_copy(update={"window_ms": 1.0})
    observe = type(stage.observe)(stage.wiring, short, config.robot.contact_cell, MS)
    for k in range(BASE, step + 5):
        newton = 45.0 if k <= step else 90.0
        stage.tick(k * MS, newton=newton, metre=0.2e-3 * (k - BASE), force=45.0)
        if (k - step) % 2 == 0:
            found = observe(k * MS, stage.heard, [claim(at_ms=k)])
    assert found.mean_torque == pytest.approx(90.0, abs=0.3)
    assert found.rate == pytest.approx(0.2, rel=0.05)


SPEED = 0.5
"""m/s"""


@pytest.mark.parametrize(
    ("syncs", "told"),
    [
        ((1, 1, 1, 1), False),
        ((1, 2, 1, 0), False),  # one may come just before a tick and the other just after
        ((1, 3, 0, 0), False),
        ((1, 1, 1, 0), True),
        ((2, 1, 1, 1), True),
        ((1, 0, 1, 0), True),
        ((3, 0, 0, 0), True),
    ],
)
def test_the_rate_over_the_last_looks_is_told_where_syncs_are_irregular(
    stage: Stage, syncs: tuple[int, ...], told: bool
) -> None:
    """The drums turn at one speed, and answer so many SYNCs in each of four ticks."""
    found = []
    for k in range(BASE, BASE + 60):
        for _ in range(syncs[k % 4]):
            stage.tick(k * MS, newton=45.0, metre=SPEED * (k - BASE) * 1e-3, force=45.0)
        if k % 2:
            found.append(stage.observe(k * MS, stage.heard, [claim(at_ms=k)]))
    for look in found[12:]:
        assert np.isfinite(look.travel).all() == told
        assert np.isfinite(look.travel).any() == told
    mean = np.mean([look.travel for look in found[12:]], axis=0)
    assert not told or mean == pytest.approx(np.full(N, SPEED), rel=0.05)


def test_bunches_of_syncs_hide_no_speed(stage: Stage) -> None:
    """One in a tick before a look, three in the one after it, and none in the next six: by their
    number they are four ticks. Until 2026-11-28 a third of the speed was found."""
    rates, travels = [], []
    for k in range(BASE, BASE + 80):
        for _ in range({1: 1, 2: 3}.get(k % 8, 0)):
            # Read in the look.
            stage.tick((k | 1) * MS, newton=45.0, metre=SPEED * (k - BASE) * 1e-3, force=45.0)
        if k % 2:
            look = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
            rates.append(look.rate)
            travels.append(np.fmax(look.rate, look.travel))
    assert np.min(rates[20:]) < 0.4 * SPEED
    assert np.min(travels[20:]) > 0.8 * SPEED


def test_where_no_time_passes_between_answers_none_is_told(stage: Stage) -> None:
    for look in range(3):
        for _ in range(3):
            stage.tick(BASE * MS, newton=45.0, metre=0.1 * look, force=45.0)
        found = stage.observe((BASE + look) * MS, stage.heard, [claim()])
        assert np.isnan(found.travel).all()


def test_one_answer_too_many_or_too_few_is_no_irregular_sync(stage: Stage) -> None:
    """In the window: it may be of a frame that came twice, or is lost."""
    for k in range(BASE, BASE + 120):
        for _ in range({0: 2, 20: 0}.get(k % 40, 1)):
            stage.tick(k * MS, newton=45.0, metre=SPEED * (k - BASE) * 1e-3, force=45.0)
        if k % 2:
            found = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
            assert np.isnan(found.travel).all()


def test_over_how_many_looks_an_irregular_rate_is_taken(config: Config) -> None:
    """Four, or as many as there are: the drums stand, and turn in the last four."""
    for looks in (2, 3, 4, 5, 6, 9):
        fresh = Stage(config)
        for look in range(looks):
            now_ns = (BASE + 2 * look) * MS
            moved = max(0, look - (looks - 5)) if looks > 5 else look
            for _ in range(5):
                fresh.tick(now_ns, newton=45.0, metre=SPEED * moved * 2e-3, force=45.0)
            found = fresh.observe(now_ns, fresh.heard, [claim(at_ms=BASE + 2 * look)])
        assert found.travel == pytest.approx(np.full(N, SPEED), rel=0.05)
