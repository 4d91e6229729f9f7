"""What the supervisor makes of frames and records before it judges."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    N,
    Stage,
    claim,
    judged,
    seen,
)
from tonus.config import Config, load
from tonus.runtime.supervisor.listener import Heard
from tonus.runtime.supervisor.observation import Observer
from tonus.runtime.supervisor.wiring import Value, limit_of


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def test_what_neither_tension_nor_motion_explain(config: Config) -> None:
    """A drum that accelerates as its torque, its cable and its bearings have it is explained; the
    same with 100 N more torque is not, by 100 N."""
    stage, extra = Stage(config), Stage(config)
    axis = stage.wiring.axes[0]
    acceleration, force = 2.0, 45.0
    for k in range(40):
        t = k * 1e-3
        metre, rate = 0.5 * acceleration * t * t, acceleration * t
        pull = force + axis.mass * acceleration + axis.damping * rate
        for each, more in ((stage, 0.0), (extra, 100.0)):
            each.tick(k * MS, newton=pull + more, metre=metre, force=force)
        if k % 2 == 0:
            found = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
            other = extra.observe(k * MS, extra.heard, [claim(at_ms=k)])
            if k < 16:
                assert np.isnan(found.unexplained).all()
    assert found.rate == pytest.approx(acceleration * 0.037, rel=0.02)
    mass = np.array([axis.mass for axis in stage.wiring.axes])
    assert found.momentum == pytest.approx(mass * found.rate)
    assert np.abs(found.unexplained).max() < 2.0
    assert other.unexplained == pytest.approx(100.0, abs=2.5)
    assert found.tension == pytest.approx(force)
    assert found.enabled.all()


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("force", [0.0, 100.0])
@pytest.mark.parametrize(("share", "known"), [(0.98, True), (1.02, False)])
def test_a_motion_that_no_motor_can_make_is_the_encoders(
    config: Config, way: float, force: float, share: float, known: bool
) -> None:
    """It contradicts no torque. The rate is what was reported."""
    stage = Stage(config)
    axis, settings = stage.wiring.axes[0], config.supervisor
    assert axis.newton is not None
    assert settings is not None
    possible = axis.limit * abs(axis.newton) + force + settings.unexplained_force
    # The last two looks are 2 ms apart, and rates are of the middle between two.
    acceleration = way * share * possible / (axis.mass + axis.damping * 0.037)
    for k in range(40):
        metre = 0.5 * acceleration * (k * 1e-3) ** 2
        stage.tick(k * MS, newton=50.0, metre=metre, force=force)
        if k % 2 == 0:
            found = stage.observe(k * MS, stage.heard, [claim(at_ms=k)])
    assert found.rate == pytest.approx(acceleration * 0.037, rel=0.01)
    assert (found.incredible == (not known)).all()
    if known:
        left = 50.0 - force - way * share * possible
        assert found.unexplained == pytest.approx(left, rel=0.01)
    else:
        assert np.isnan(found.unexplained).all()


@pytest.mark.parametrize("phase_ns", [-50_000, 0, 50_000])
def test_the_rate_does_not_depend_on_when_it_looks(config: Config, phase_ns: int) -> None:
    """Where PDOs arrive just when it looks, one look has one more of them than another."""
    stage = Stage(config)
    ticks = iter(range(200))
    tick = next(ticks)
    random = np.random.default_rng(3)
    for look in range(60):
        now_ns = look * 2 * MS + phase_ns + int(random.integers(-60_000, 60_000))
        while tick * MS <= now_ns:
            stage.tick(tick * MS, newton=45.0, metre=0.226e-3 * tick, force=45.0)
            tick = next(ticks)
        found = stage.observe(now_ns, stage.heard, [claim(at_ms=2.0 * look)])
        if look >= 10:
            assert found.rate == pytest.approx(0.226, rel=0.01)
            assert np.abs(found.unexplained).max() < 10.0


@pytest.mark.parametrize(("lost", "looks"), [(20, 2), (21, 2)])
def test_a_frame_that_is_lost_shows_in_single_looks(config: Config, lost: int, looks: int) -> None:
    """At either end of the window, so never in two looks in a row."""
    stage, beyond = Stage(config), []
    axis = stage.wiring.axes[0]
    for tick in range(60):
        before = stage.heard[axis.channel, axis.received]
        if tick == lost:
            stage.heard[axis.channel, axis.received] = Heard((axis.position,), axis.statusword)
        stage.tick(tick * MS, newton=45.0, metre=0.226e-3 * tick, force=45.0)
        stage.heard[axis.channel, axis.received] = before
        if tick % 2 == 1:
            found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
            beyond.append(abs(found.unexplained[0]) > 40.0)
    assert 0 < sum(beyond) <= looks
    assert not any(first and second for first, second in pairwise(beyond))


def test_answers_that_come_too_often_do_not_slow_a_drum(config: Config) -> None:
    """Two SYNCs a tick, or a drive that sends each of its PDOs twice."""
    stage = Stage(config)
    for tick in range(40):
        for half in (0.0, 0.5):
            stage.tick(tick * MS, newton=45.0, metre=0.5e-3 * (tick + half), force=45.0)
        if tick % 2:
            found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate == pytest.approx(0.5, rel=0.02)


def test_a_tick_as_long_as_the_time_between_two_looks(config: Config) -> None:
    """Some looks find no new answer, and others two."""
    stage, random = Stage(config), np.random.default_rng(2)
    assert config.supervisor is not None
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, 2 * MS)
    tick = 0
    for look in range(60):
        now_ns = 2 * MS * look + int(random.integers(-60_000, 60_000))
        while 2 * MS * tick <= now_ns:
            stage.tick(now_ns, newton=45.0, metre=0.4e-3 * tick, force=45.0)
            tick += 1
        found = stage.observe(now_ns, stage.heard, [claim(at_ms=2.0 * look)])
        if look >= 10:
            assert found.rate == pytest.approx(0.2, rel=0.02)
            assert np.abs(found.unexplained).max() < 10.0


@pytest.mark.parametrize("quick", [True, False])
def test_a_drive_in_quick_stop_is_powered(config: Config, quick: bool) -> None:
    """In a reaction to a fault it is not the daemon's any more, and that ends by itself."""
    stage = Stage(config)
    axis = stage.wiring.axes[2]
    heard = stage.heard[axis.channel, axis.received]
    assert not heard.powered
    heard.take([(0x0207 if quick else 0x020F) << axis.statusword.shift], 1)
    assert heard.powered is quick
    heard.take([0x0237 << axis.statusword.shift], 2)
    assert heard.powered
    heard.take([0x0233 << axis.statusword.shift], 3)
    assert not heard.powered
    assert heard.on == 1 + quick


def test_drives_that_had_power_between_two_looks(config: Config) -> None:
    """However short: a daemon may switch them tick by tick."""
    stage = Stage(config)

    def send(word: int, axes: Any) -> None:
        for axis in axes:
            received = stage.heard[axis.channel, axis.received]
            received.take([word << axis.statusword.shift], 1)

    axes = stage.wiring.axes
    send(0x0240, axes)
    assert not stage.observe(MS, stage.heard, [claim()]).enabled.any()
    send(0x0237, axes[:3])
    send(0x0240, axes)
    found = stage.observe(2 * MS, stage.heard, [claim()])
    assert found.enabled.tolist() == [True] * 3 + [False] * 5
    assert not stage.observe(3 * MS, stage.heard, [claim()]).enabled.any()
    send(0x0237, axes)
    assert stage.observe(4 * MS, stage.heard, [claim()]).enabled.all()
    assert stage.observe(5 * MS, stage.heard, [claim()]).enabled.all(), "nothing new came"


@pytest.mark.parametrize("answered_ms", [1, 2, 4, 6])
@pytest.mark.parametrize("statusword", [0x0231, 0x0233, 0x0250, 0x0208, 0x020F])
def test_drives_that_are_told_to_have_power(
    config: Config, statusword: int, answered_ms: int
) -> None:
    """The answer to the SYNC on which it acts says that they are off still, so whenever it came,
    and whatever acts after it, it counts until two more have come. A drive in fault that answers
    takes no such command."""
    stage = Stage(config)
    stage.tick(MS, newton=45.0, metre=1.0, force=45.0)
    drives = [
        (axis, stage.heard[axis.channel, axis.sent], stage.heard[axis.channel, axis.received])
        for axis in stage.wiring.axes
    ]

    def look(controlwords: Sequence[int], answers: int = 0) -> bool:
        for axis, told, answer in drives:
            for word in controlwords:
                told.take([word], 4 * MS)
            for _ in range(answers):
                answer.take([statusword << axis.statusword.shift], answered_ms * MS)
        found = stage.observe(6 * MS, stage.heard, [claim()])
        assert found.enabled.all() == found.enabled.any()
        return bool(found.enabled.all())

    assert look([0x06], 1), "it was, in this look"
    assert not look([], 2)
    assert not look([0x07])
    fails = statusword in (0x0208, 0x020F)
    for acting in ([0x0F, 0x06], [0x0F, 0x07, 0x06]):
        starts = not fails or answered_ms == 1
        assert look(acting, 1) is starts
        assert look([0x06], 1) is starts, "this one may be of before"
        assert look([], 0) is starts
        assert not look([0x06], 1)
    held = statusword in (0x0231, 0x0233)
    look([0x0F])
    assert look([], 5) is held


def test_how_long_drives_are_taken_at_what_they_were_told(config: Config) -> None:
    """One that never answers may have been pulled since."""
    stage = Stage(config)
    for axis in stage.wiring.axes:
        stage.heard[axis.channel, axis.sent].take([0x0F], MS)
        stage.heard[axis.channel, axis.sent].take([0x00], MS)
    for now_ns, told in ((MS, True), (21 * MS - 1, True), (21 * MS, False)):
        found = stage.observe(now_ns, stage.heard, [claim()])
        assert found.told.all() == found.told.any() == told
        assert found.enabled.tolist() == found.told.tolist()


def test_where_it_is_not_known_what_drives_are_told(config: Config) -> None:
    """Drives that are switched on and answer no more may have power, and so may any that is sent a
    torque; four ticks are no silence. What was sent long ago is no torque."""
    stage, settings = Stage(config), config.supervisor
    assert settings is not None
    stage.wiring.axes[:] = [replace(axis, controlword=None) for axis in stage.wiring.axes]
    observe = Observer(stage.wiring, settings, config.robot.contact_cell, MS)
    stage.tick(MS, newton=45.0, metre=1.0, force=45.0)
    for statusword, enabled in ((0x0233, True), (0x0231, True), (0x0250, False), (0x0208, False)):
        for mille in (0, 1, -1):
            for axis in stage.wiring.axes:
                answer = stage.heard[axis.channel, axis.received]
                answer.take([statusword << axis.statusword.shift], 2 * MS)
                word = (mille & 0xFFFF) << axis.torque.shift
                stage.heard[axis.channel, axis.sent].take([word], 2 * MS)
            observe(2 * MS, stage.heard, [claim()])
            assert not observe(6 * MS, stage.heard, [claim()]).enabled.any()
            for now_ns, told in ((6 * MS + 1, mille != 0), (22 * MS, False)):
                found = observe(now_ns, stage.heard, [claim()])
                assert found.told.all() == found.told.any() == told
                assert found.enabled.all() == found.enabled.any() == (enabled or told)


def test_the_least_and_the_largest_torque_between_two_looks(config: Config) -> None:
    """Whichever way a motor turns, and whatever the other drives are sent; of a drive that was sent
    none, the last."""
    stage = Stage(config)
    axes = stage.wiring.axes
    assert axes[1].newton is not None
    axes[1] = replace(axes[1], newton=-axes[1].newton)
    assert config.supervisor is not None
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    sent = np.array([[30, -50, 100, 20]]).T * np.arange(N, 0, -1)
    newton = np.array([axis.newton for axis in axes], float)
    for torques, wanted in ((sent, sent * newton), (sent[:0], sent[-1:] * newton)):
        for mille in torques.tolist():
            for axis, each in zip(axes, mille, strict=True):
                word = (each & 0xFFFF) << axis.torque.shift
                stage.heard[axis.channel, axis.sent].take([word], MS)
        found = stage.observe(MS, stage.heard, [claim()])
        assert found.torques == pytest.approx(np.array([wanted.min(axis=0), wanted.max(axis=0)]))
        assert found.torque == pytest.approx(sent[-1] * newton)


def test_a_torque_that_acts_while_others_wait_for_the_next_sync(config: Config) -> None:
    """It is the largest, in each look until that."""
    stage = Stage(config)
    axis = stage.wiring.axes[3]
    assert axis.newton is not None
    acting, waiting = 200, -30
    wanted = sorted((acting * axis.newton, waiting * axis.newton))
    sent = stage.heard[axis.channel, axis.sent]
    sent.take([(acting & 0xFFFF) << axis.torque.shift], MS)
    stage.observe(MS, stage.heard, [claim()])
    for look in (2, 3):
        sent.numbers.append(waiting)
        found = stage.observe(look * MS, stage.heard, [claim()])
        assert found.torques[:, 3].tolist() == pytest.approx(wanted)
        assert found.torque[3] == pytest.approx(acting * axis.newton)


@pytest.mark.parametrize(
    ("statusword", "told", "enabled", "useless"),
    [
        (0x0237, 0x0F, True, False),
        (0x0240, 0x0F, True, True),
        (0x0233, 0x0F, True, True),
        (0x0207, 0x0F, True, True),
        (0x0240, 0x00, False, True),
    ],
)
def test_what_a_drive_answers_beside_what_it_is_told(
    config: Config, statusword: int, told: int, enabled: bool, useless: bool
) -> None:
    """Told to have power it counts as having it, for whoever asks for its torques, and as having
    none for whoever needs it to control the robot."""
    stage = Stage(config)
    for look in range(1, 6):
        for axis in stage.wiring.axes:
            assert axis.controlword is not None
            stage.heard[axis.channel, axis.sent].take(
                [told << axis.controlword.shift], look * 2 * MS
            )
            word = [statusword << axis.statusword.shift]
            stage.heard[axis.channel, axis.received].take(word, look * 2 * MS)
        found = stage.observe(look * 2 * MS, stage.heard, [claim()])
        assert found.enabled.tolist() == [enabled] * N
        assert found.useless.tolist() == [useless] * N


@pytest.mark.parametrize(
    ("mille", "limited"), [(1999, False), (2000, True), (-1999, False), (-2000, True), (0, False)]
)
def test_a_torque_at_the_motors_limit(config: Config, mille: int, limited: bool) -> None:
    """16 A of 8 A; an axis with another motor has another limit."""
    stage = Stage(config)
    assert {axis.limit for axis in stage.wiring.axes} == {2000}
    motor = config.robot.motor.model_copy(update={"current_limit": 12.345})
    assert limit_of(motor) == 1543
    axis = stage.wiring.axes[3]
    stage.tick(0, newton=45.0, metre=0.0, force=45.0)
    stage.heard[axis.channel, axis.sent].take([(mille & 0xFFFF) << axis.torque.shift], MS)
    found = stage.observe(MS, stage.heard, [claim()])
    assert found.limited.tolist() == [number == 3 and limited for number in range(N)]


def test_positions_that_stop_to_arrive(config: Config) -> None:
    """No division by nothing: the drum is taken to rest after ``patience_ms``."""
    stage = Stage(config)
    for tick in range(20):
        stage.tick(tick * MS, newton=45.0, metre=0.1e-3 * tick, force=45.0)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate == pytest.approx(0.1, rel=0.02)
    for tick in range(20, 30, 2):
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.rate.tolist() == [0.0] * N


def test_how_long_a_drum_that_does_not_answer_goes_on(config: Config) -> None:
    """``patience_ms`` after its last answer, and not a nanosecond longer."""
    stage = Stage(config)
    assert config.supervisor is not None
    assert config.supervisor.patience_ms == 5
    for tick in range(20):
        stage.tick(tick * MS, newton=45.0, metre=0.1e-3 * tick, force=45.0)
        stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    for now_ns, rate in ((24 * MS, 0.1), (24 * MS + 1, 0.0)):
        found = stage.observe(now_ns, stage.heard, [claim(at_ms=24.0)])
        assert found.rate == pytest.approx(rate, rel=0.02)


def test_which_drives_are_sent_a_torque(config: Config) -> None:
    """By the one that acts, and by any that was sent since the last look, whether or not it
    acted."""
    stage = Stage(config)

    def look(acting: Sequence[int], waiting: Sequence[int] = ()) -> bool:
        for axis in stage.wiring.axes:
            told = stage.heard[axis.channel, axis.sent]
            for mille in acting:
                told.take([(mille & 0xFFFF) << axis.torque.shift], MS)
            told.send([(mille & 0xFFFF) << axis.torque.shift for mille in waiting])
        found = stage.observe(MS, stage.heard, [claim()]).pulled
        assert found.all() == found.any()
        return bool(found.all())

    for mille in (1, -1, 300):
        assert not look([0])
        assert not look([]), "nothing new"
        assert look([0], [mille]), "that one waits"
        assert not look([])
        assert look([0, mille, 0])
        assert not look([])
        assert look([mille])
        assert look([])
        assert look([], [0]), "another acts still"


@pytest.mark.parametrize("every", [1, 3, 4, 6])
def test_answers_that_come_seldom(config: Config, every: int) -> None:
    """A SYNC in every sixth tick makes no drum stand in any look."""
    stage = Stage(config)
    for tick in range(60):
        if tick % every == 0:
            stage.tick(tick * MS, newton=45.0, metre=0.3e-3 * tick, force=45.0)
        if tick % 2 == 0:
            found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
            if tick > 20:
                assert found.rate == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize("gap", [2, 3, 4, 5, 12])
def test_answers_that_are_missing_explain_nothing_and_contradict_nothing(
    config: Config, gap: int
) -> None:
    """A drum goes on at 0.3 m/s: as long as it does not answer nobody knows, and then it is known
    over the whole gap. Where it has to be known it goes on for ``patience_ms``, and is at rest
    then."""
    stage, silent = Stage(config), range(40, 40 + gap)
    axis = stage.wiring.axes[3]
    received = (axis.channel, axis.received)
    for tick in range(80):
        before = stage.heard[received]
        if tick in silent:
            stage.heard[received] = Heard((axis.position,), axis.statusword)
        stage.tick(tick * MS, newton=45.0, metre=0.3e-3 * tick, force=45.0)
        stage.heard[received] = before
        if tick % 2:
            continue
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
        if tick < 20:
            continue
        others = np.arange(N) != 3
        assert found.rate[others] == pytest.approx(0.3, rel=0.02)
        assert np.abs(found.unexplained[others]).max() < 12.0
        missing = tick in silent and tick - 1 in silent
        unknown = missing and tick - 39 > 5
        assert found.rate[3] == pytest.approx(0.0 if unknown else 0.3, rel=0.02)
        assert np.isnan(found.unexplained[3]) or abs(found.unexplained[3]) < 12.0
        assert np.isnan(found.unexplained[3]) >= missing
        assert found.jolt[3] < 0.01
    assert not np.isnan(found.unexplained).any()


def test_how_far_a_force_and_a_drum_go_while_the_torques_stay(config: Config) -> None:
    stage = Stage(config)
    metre, swings, jolts = 0.0, [], []
    for tick in range(60):
        speed = 0.1 + 0.002 * tick
        metre += speed * 1e-3
        newton = 45.0 + min(tick, 30)
        stage.tick(tick * MS, newton=newton, metre=metre, force=45.0 + 0.1 * tick)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
        swings.append(found.swing.max())
        jolts.append(found.jolt.max())
    assert max(swings[:31]) == 0.0
    assert max(jolts[:31]) == 0.0
    assert swings[31:] == pytest.approx(0.1 * np.arange(1, 30), abs=0.02)
    assert jolts[31:] == pytest.approx(0.002 * np.arange(1, 30), abs=0.003), "an encoder's count"


def test_a_drum_that_changes_its_rate_shows_in_the_next_look(config: Config) -> None:
    stage, metre = Stage(config), 0.0
    for tick in range(50):
        metre += 0.1e-3 if tick <= 40 else 0.2e-3
        stage.tick(tick * MS, newton=45.0, metre=metre, force=45.0)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
        assert (found.jolt.min() > 0.09, found.jolt.max() < 0.01) == (tick > 40, tick <= 40)


def test_a_drive_that_alone_knows_its_scale(config: Config) -> None:
    """Neither its torque nor its drum's rate is judged."""
    stage = Stage(config)
    stage.wiring.axes = [replace(axis, newton=None, metre=None) for axis in stage.wiring.axes]
    assert config.supervisor is not None
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    for tick in range(40):
        for axis in stage.wiring.axes:
            stage.heard[axis.channel, axis.sent].take([100 << axis.torque.shift], tick * MS)
            stage.heard[axis.channel, axis.received].take([tick << axis.position.shift], tick * MS)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert np.isnan(found.rate).all()
    assert np.isnan(found.torque).all()
    assert judged(config, seen(rate=found.rate, same=np.full(N, 6), swing=np.zeros(N))) == [None]


def test_before_anything_was_heard(config: Config) -> None:
    stage = Stage(config)
    found = stage.observe(MS, stage.heard, [])
    assert not found.enabled.any()
    assert np.isinf(found.torque_age).all()
    assert np.isnan(found.tension).all()
    assert np.isnan(found.contact)
    assert found.swing.tolist() == found.jolt.tolist() == [0.0] * N
    again = stage.observe(2 * MS, stage.heard, [claim()])
    assert np.isnan(again.tension).all()


@pytest.mark.parametrize("force", [float("nan"), float("inf"), float("-inf")])
def test_a_force_that_is_no_number_is_beyond_every_bound(config: Config, force: float) -> None:
    stage = Stage(config)
    assert config.supervisor is not None
    sound = stage.wiring.cells
    stage.wiring.cells = [
        replace(cell, force=Value(cell.force.shift, 32, real=True), newton=1.0) for cell in sound
    ]
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    word = int.from_bytes(struct.pack("<f", force), "little")
    for cell in stage.wiring.cells:
        stage.heard[cell.channel, cell.received] = Heard((cell.force,))
        stage.heard[cell.channel, cell.received].take([word << cell.force.shift], 0)
    found = stage.observe(MS, stage.heard, [claim()])
    assert (found.tension == np.inf).all()
    assert found.contact == np.inf
    assert found.cell_age.tolist() == [1.0] * N
    assert found.contact_age == 1.0


def test_a_cell_is_defective_until_its_amplifier_takes_the_error_back(config: Config) -> None:
    """An error of the bus says nothing of what is measured, and takes no error of a cell back."""
    stage = Stage(config)
    cells = {cell.number: cell for cell in stage.wiring.cells}
    assert cells[2].emergency == 0x080 + 17 + 2
    for number in (2, config.robot.contact_cell):
        emergency = stage.heard[cells[number].channel, cells[number].emergency]
        for code, bad in (
            *((0x8130, False), (0, False), (0x5010, True), (0x1000, True), (0x8042, True)),
            *((0x8310, True), (0x8130, True), (0x8210, True), (0, False), (0x8210, False)),
        ):
            emergency.take([code | 0x81 << 16], MS)
            found = stage.observe(MS, stage.heard, [claim()])
            assert found.contact_defective is (bad and number != 2)
            assert found.defective.tolist() == [bad and number == axis for axis in range(N)]


@pytest.mark.parametrize("force", [float("nan"), float("inf"), 1e30, -1e30])
def test_a_force_that_is_no_number_once_is_in_no_sum(force: float) -> None:
    value = Value(0, 32, real=True)
    heard = Heard((value,))
    for each in (1.5, force, 2.5):
        heard.take([int.from_bytes(struct.pack("<f", each), "little")], 1)
    assert heard.totals == [4.0]
    assert heard.count == 3
    heard.take([int.from_bytes(struct.pack("<f", 2.0**32), "little")], 1)
    assert heard.totals == [4.0 + 2.0**32], "as large as an integer may be"


def test_cells_on_another_bus(config: Config) -> None:
    stage = Stage(config)
    assert config.supervisor is not None
    stage.wiring.cells = []
    stage.observe = Observer(stage.wiring, config.supervisor, config.robot.contact_cell, MS)
    for k in range(30):
        stage.tick(k * MS, newton=45.0, metre=0.0, force=45.0)
        found = stage.observe(k * MS, stage.heard, [claim()])
    assert np.isnan(found.tension).all()
    assert np.isnan(found.unexplained).all()
    assert np.isnan(found.contact)
    assert not found.cell_age.any()
    assert found.contact_age == 0.0


def test_a_torque_is_as_old_as_what_it_acted_on_last(config: Config) -> None:
    """A torque that waits for its SYNC is none yet, and was sent for SUP-10 all the same."""
    stage = Stage(config)
    stage.tick(0, newton=45.0, metre=0.0, force=45.0)
    axes = stage.wiring.axes
    stage.heard[axes[0].channel, axes[0].sent].act([0], 3 * MS)
    stage.heard[axes[7].channel, axes[7].sent].send([77 << axes[7].torque.shift])
    found = stage.observe(5 * MS, stage.heard, [claim()])
    assert found.torque_age.tolist() == [2.0, *[5.0] * 7]
    assert found.mille[7] != 77
    assert found.torques[:, 7].max() >= 77 * abs(axes[7].newton or 0.0)


def test_how_far_drums_go_without_power_is_nothing_that_a_torque_has_left_as_it_is(
    config: Config,
) -> None:
    """They are turned by hand, or the platform comes down; then they are enabled."""
    stage = Stage(config)
    metre = 0.0
    for tick in range(80):
        metre += 0.2e-3 * (10 <= tick < 30)
        on = tick >= 50
        stage.tick(tick * MS, newton=0.0, metre=metre, force=1.0 if tick < 40 else 3.0, on=on)
        found = stage.observe(tick * MS, stage.heard, [claim(at_ms=tick)])
    assert found.enabled.all()
    assert found.jolt.max() < 0.01
    assert found.swing.max() < 0.1
