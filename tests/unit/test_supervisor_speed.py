"""The judge: what the drums tell of the speed of the platform (SUP-8)."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import (
    MS,
    STRICT,
    N,
    Stage,
    at,
    claim,
    judged,
    lasting,
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.judge import Judge
from tonus.runtime.supervisor.platform_speed import PlatformSpeed


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def test_rotation_of_the_platform(config: Config) -> None:
    """Rates made from a rotation about each axis in the middle."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    along = (frame - platform) / np.linalg.norm(frame - platform, axis=1, keepdims=True)
    for said, after, slow, fast in (
        (claim(State.ACTIVE), 5.0, 1.2, 2.2),
        (claim(State.SAFE_STOP, stop_mode=StopMode.PASSIVE), 110.0, 6.0, 15.0),
    ):
        for axis, (rate, found) in product(np.eye(3), ((slow, False), (fast, True))):
            arms = rate * np.cross(platform, along) @ axis
            damped = np.maximum(-120.0 * arms, 0.0)
            torque = np.full(N, 45.0) if said.state == State.ACTIVE else damped
            looks = [
                seen(at_ms, replace(said, at_ns=round(at_ms * MS)), rate=arms, torque=torque)
                for at_ms in (100.0, 100.0 + after)
            ]
            verdict = judged(config, *looks)[-1]
            assert (verdict is not None) is found
            assert verdict is None or verdict.requirement is Requirement.SPEED


def test_the_speed_of_the_drums_bounds_that_of_the_platform(config: Config) -> None:
    """Rates made from a motion of the platform in the middle: just within, and just beyond."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    for speed, expected in ((0.274, None), (0.6, Requirement.SPEED)):
        for direction in np.eye(3):
            along = frame - platform
            rates = along @ (speed * direction) / np.linalg.norm(along, axis=1)
            found = lasting(config, 5.0, rate=rates, mille=np.full(N, 100))
            assert (found and found.requirement) == expected
    some = lasting(config, 5.0, rate=np.full(N - 1, 9.0))
    assert some is None, "some axes on another bus: not judged"


@pytest.mark.parametrize(("faster", "found"), [("rate", True), ("travel", True), ("none", False)])
def test_rates_over_more_looks_count_where_syncs_are_irregular(
    config: Config, faster: str, found: bool
) -> None:
    """The larger speed of both, also where the newest rates are not known."""
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    fast, slow = along @ np.array([0.0, 0.0, 0.6]), along @ np.array([0.0, 0.0, 0.1])
    given = {"rate": slow, "travel": slow, "mille": np.full(N, 100)} | {faster: fast}
    given.pop("none", None)
    verdict = lasting(config, 5.0, **given)
    assert (verdict and verdict.requirement) == (Requirement.SPEED if found else None)
    given["travel"] = at(3, fast[3], np.nan)
    verdict = lasting(config, 5.0, **given)
    assert (verdict is not None) is (faster == "rate"), "with the newest rates of the others"
    given["rate"], given["travel"] = slow, np.where(np.arange(N) == 3, np.nan, fast)
    verdict = lasting(config, 5.0, **given)
    assert (verdict and verdict.requirement) == Requirement.SPEED, "of all drums but one"
    given["rate"], given["travel"] = np.full(N, np.nan), fast
    verdict = lasting(config, 5.0, **given)
    assert verdict is not None
    assert verdict.requirement is Requirement.SPEED


def test_the_speed_does_not_depend_on_the_order_of_the_drives(config: Config) -> None:
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    rates = along @ np.array([0.0, 0.0, 0.6]) / np.linalg.norm(along, axis=1)
    order = np.array([0, 4, 1, 5, 2, 6, 3, 7])
    found = [lasting(config, 200.0, rate=rates[axes], axes=axes) for axes in (np.arange(N), order)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[1].value == pytest.approx(found[0].value)


@pytest.mark.parametrize(
    ("powered", "tension", "found"),
    [(False, 4.9, False), (False, 5.0, True), (True, 4.9, True), (False, np.nan, True)],
)
def test_a_drum_that_nothing_holds(
    config: Config, powered: bool, tension: float, found: bool
) -> None:
    """Without power and with a slack cable: it may turn as it will, and the others tell."""
    others = at(2, 0.0, 1.0) > 0.0
    given = {"enabled": others | powered, "tension": at(2, tension, 45.0)}
    for order in (np.arange(N), np.array([0, 4, 1, 5, 2, 6, 3, 7])):
        turned = {key: value[order] for key, value in given.items()}
        look = {"rate": at(2, -9.0)[order], "axes": order, **turned}
        verdict = lasting(config, 110.0, State.SAFE_STOP, **look)
        assert (verdict and verdict.requirement) == (Requirement.SPEED if found else None)
        fast = {"rate": np.where(order < 4, -4.0, 4.0)}
        rising = lasting(config, 110.0, State.SAFE_STOP, **look | fast)
        assert rising is not None, "seven drums are enough"
        assert rising.requirement is Requirement.SPEED


@pytest.mark.parametrize("shift", [0.0, 0.12])
def test_the_bound_of_the_platforms_speed_is_the_least_over_the_poses(
    config: Config, shift: float
) -> None:
    """Against least squares at each of 27 poses, for motions with rotation and without; in a
    workspace whose middle is the frame's, and in another."""
    space = config.robot.workspace
    moved = {key: tuple(end + shift for end in getattr(space, key)) for key in ("x", "y", "z")}
    there = config.robot.model_copy(update={"workspace": space.model_copy(update=moved)})
    config = config.model_copy(update={"robot": there})
    geometry, space, settings = config.robot.geometry, config.robot.workspace, config.supervisor
    assert settings is not None
    turning = settings.model_copy(update={"rotation": 1e9, "rotation_stopping": 1e9})
    calm = config.model_copy(update={"supervisor": turning})
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    middle = [0.5 * (low + high) for low, high in (space.x, space.y, space.z)]

    def rows(position: Any) -> Any:
        found = np.empty((N, 6))
        for cable in range(N):
            arm = frame[cable] - (position + platform[cable])
            found[cable, :3] = arm / np.linalg.norm(arm)
            found[cable, 3:] = np.cross(platform[cable], found[cable, :3])
        return found

    random = np.random.default_rng(4)
    for _ in range(20):
        twist = np.concatenate([random.normal(0.0, 2.0, 3), random.normal(0.0, 4.0, 3)])
        at_pose = np.array(middle) + random.uniform(-0.1, 0.1, 3)
        rates = rows(at_pose) @ twist
        least = np.inf
        for x in (-settings.spread, 0.0, settings.spread):
            for y in (-settings.spread, 0.0, settings.spread):
                for z in (-settings.spread, 0.0, settings.spread):
                    matrix = rows(np.add(middle, (x, y, z)))
                    solved = np.linalg.lstsq(matrix, rates, rcond=None)[0]
                    least = min(least, float(np.linalg.norm(solved[:3])))
        given = {"rate": rates, "unexplained": np.zeros(N)}
        found = lasting(calm, 200.0, **given)
        limit = 1.1 * config.control.envelope.speed_limit
        assert (found is not None) is (least > limit)
        assert found is None or found.value == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize("every", range(1, 20))
def test_the_speed_of_a_platform_of_which_half_of_the_drums_answer_seldom(
    config: Config, every: int
) -> None:
    """In each ``every``-th tick, and not together. At 0.6 m/s, in the direction in which the drums
    that answer in each tick show the least of it."""
    assert config.supervisor is not None
    stage, judge = Stage(config), Judge(config, config.supervisor)
    geometry = config.robot.geometry
    attachments = np.array(geometry.frame) - np.array(geometry.platform)
    direction, seldom = np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0), (2, 3, 4, 5)

    def lengths(metre: float) -> Any:
        return np.linalg.norm(attachments - metre * direction, axis=1)

    begins, found = 40, None
    for tick in range(1, begins + 80):
        reeled = lengths(0.0) - lengths(0.6e-3 * max(tick - begins, 0))
        for axis in stage.wiring.axes:
            if axis.number in seldom and (tick + axis.number) % every:
                continue
            place = round(reeled[axis.number] / axis.metre) & 0xFFFFFFFF
            word = place << axis.position.shift | 0x0237
            stage.heard[axis.channel, axis.received].take([word], tick * MS)
        if tick % 2:
            continue
        looked = stage.observe(tick * MS, stage.heard, [claim(at_ms=float(tick))])
        # What the others tell is not what is asked here.
        found = judge(replace(seen(at_ms=float(tick)), rate=looked.rate, axes=looked.axes))
        if found is not None:
            break
    assert found is not None
    assert found.requirement is Requirement.SPEED
    assert tick - begins <= 10 + 2 * every


@pytest.mark.parametrize(
    ("mode", "speed", "for_ms", "found"),
    [
        (StopMode.DESCENT, 1.0, 41.9, False),
        (StopMode.DESCENT, 1.0, 42.0, True),
        (StopMode.DESCENT, 0.7, 60.0, False),
        (StopMode.NONE, 1.0, 42.0, True),
        (StopMode.ON_PATH, 0.6, 41.9, False),
        (StopMode.ON_PATH, 0.6, 42.0, True),
        (StopMode.ON_PATH, 0.45, 60.0, False),
        (StopMode.PASSIVE, 1.0, 60.0, False),
    ],
)
def test_drums_of_slack_cables_stand_while_the_platform_is_thrown(
    config: Config, mode: StopMode, speed: float, for_ms: float, found: bool
) -> None:
    """Upwards by the upper cables: with the lower drums, which have power and stand, the least
    speed that explains all eight is half of it."""
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    rates = along @ np.array([0.0, 0.0, speed]) / np.linalg.norm(along, axis=1)
    upper = along[:, 2] > 0.0
    tension = np.where(upper, 45.0, 0.5)
    said = claim(State.SAFE_STOP, stop_mode=mode, reference=tension, tension=tension)
    given = {
        "rate": np.where(upper, rates, 0.0),
        "tension": tension,
        "torque": np.where(upper, 12.0, 0.5),
    }
    slack = config.control.tension.slack
    for lower, state, expected in (
        (slack - 0.01, State.SAFE_STOP, found),
        (slack, State.SAFE_STOP, False),
        (slack - 0.01, State.FAULT, False),
    ):
        given["tension"] = np.where(upper, 45.0, lower)
        said = replace(said, state=state)
        looks = [
            seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given)
            for at_ms in (100.0, 100.0 + for_ms)
        ]
        verdict = judged(config, *looks)[-1]
        by_speed = verdict is not None and verdict.requirement is Requirement.SPEED
        assert by_speed is expected


@pytest.mark.parametrize("incredible", [False, True])
@pytest.mark.parametrize("mode", [StopMode.DESCENT, StopMode.ON_PATH])
def test_an_encoder_that_slips_tells_nothing(
    config: Config, mode: StopMode, incredible: bool
) -> None:
    """By 3 m/s, which no motor gives a drum in a few ms."""
    said = claim(State.SAFE_STOP, stop_mode=mode)
    given = {"rate": at(6, 3.0, 0.0), "incredible": (np.arange(N) == 6) & incredible}
    for tension in (np.full(N, 45.0), at(2, 0.0, 45.0)):
        looks = [
            seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given, tension=tension)
            for at_ms in (100.0, 142.0)
        ]
        verdict = judged(config, *looks)[-1]
        by_speed = verdict is not None and verdict.requirement is Requirement.SPEED
        assert by_speed is not incredible


def test_no_taut_cable_tells_nothing(config: Config) -> None:
    said = claim(State.SAFE_STOP, stop_mode=StopMode.DESCENT)
    given = {"rate": np.full(N, 0.7), "tension": np.zeros(N), "enabled": np.arange(N) == 0}
    looks = [
        seen(at_ms, replace(said, at_ns=round(at_ms * MS)), **given, torque=np.zeros(N))
        for at_ms in (100.0, 160.0)
    ]
    verdict = judged(config, *looks)[-1]
    assert verdict is None or verdict.requirement is not Requirement.SPEED


def _cables(config: Config) -> tuple[Any, Any]:
    """From the platform's motion (6,) in the middle to the rates of the cables, and m/N of each."""
    geometry, space = config.robot.geometry, config.robot.workspace
    middle = np.array([sum(each) / 2.0 for each in (space.x, space.y, space.z)])
    platform = np.array(geometry.platform)
    along = np.array(geometry.frame) - middle - platform
    lengths = np.linalg.norm(along, axis=1)
    along /= lengths[:, None]
    rows = np.hstack([along, np.cross(platform, along)])
    return rows, lengths / config.robot.axial_stiffness


def _first(verdicts: list[Any]) -> int | None:
    """ms until the first that is of the speed; looks are 2 ms apart."""
    found = [each is not None and each.requirement is Requirement.SPEED for each in verdicts]
    return 2 * found.index(True) if any(found) else None


def _swinging(config: Config, state: State, speed: Any, given: dict[str, Any]) -> list[Any]:
    """Drums that stand, and tensions of a platform that moves at ``speed`` (6,) on its cables: the
    verdict of each look."""
    rows, compliance = _cables(config)
    # A cable that the platform moves away from is stretched.
    rate = -(rows @ np.asarray(speed)) / compliance
    looks = []
    for at_ms in np.arange(100.0, 160.0, 2.0):
        tension = 200.0 + rate * (at_ms - 100.0) * 1e-3
        said = claim(state, at_ms, tension=tension, reference=tension, **given)
        looks.append(seen(at_ms, said, tension=tension, torque=tension, mean_torque=tension))
    return judged(config, *looks)


@pytest.mark.parametrize(
    ("state", "mode", "speed", "after_ms"),
    [
        (State.ACTIVE, StopMode.NONE, (0.0, 0.0, 0.27, 0.0, 0.0, 0.0), None),
        (State.ACTIVE, StopMode.NONE, (0.0, 0.0, 0.30, 0.0, 0.0, 0.0), 22),
        (State.HOLD, StopMode.NONE, (0.30, 0.0, 0.0, 0.0, 0.0, 0.0), 22),
        (State.REFERENCING, StopMode.NONE, (0.0, 0.30, 0.0, 0.0, 0.0, 0.0), 22),
        (State.ACTIVE, StopMode.NONE, (0.0, 0.0, 0.0, 0.0, 0.0, 1.4), None),
        (State.ACTIVE, StopMode.NONE, (0.0, 0.0, 0.0, 0.0, 0.0, 1.7), 22),
        (State.SAFE_STOP, StopMode.ON_PATH, (0.0, 0.0, 0.48, 0.0, 0.0, 0.0), None),
        (State.SAFE_STOP, StopMode.ON_PATH, (0.0, 0.0, 0.0, 0.0, 0.0, 3.0), None),
        (State.SAFE_STOP, StopMode.DESCENT, (0.0, 0.0, 0.75, 0.0, 0.0, 0.0), None),
        (State.SAFE_STOP, StopMode.DESCENT, (0.0, 0.0, 0.90, 0.0, 0.0, 0.0), 44),
        (State.SAFE_STOP, StopMode.DESCENT, (0.0, 0.0, 0.0, 0.0, 0.0, 3.0), None),
        (State.SAFE_STOP, StopMode.PASSIVE, (0.0, 0.0, 0.90, 0.0, 0.0, 0.0), None),
    ],
)
def test_a_platform_that_moves_on_its_cables_while_the_drums_stand(
    config: Config, state: State, mode: StopMode, speed: Any, after_ms: int | None
) -> None:
    """The first change is known in the second look."""
    assert _first(_swinging(config, state, speed, {"stop_mode": mode})) == after_ms


def test_drums_that_stretch_their_cables_move_nothing(config: Config) -> None:
    """They reel in and out as a platform would that moves at 0.26 m/s, and each tension changes by
    just that: the platform stands. The other way round it would move twice as fast."""
    rows, compliance = _cables(config)
    rate = rows @ np.array([0.0, 0.0, 0.26, 0.0, 0.0, 0.0])
    for sign, after_ms in ((1.0, None), (-1.0, 22)):
        looks = []
        for at_ms in np.arange(100.0, 130.0, 2.0):
            tension = 120.0 + sign * rate / compliance * (at_ms - 100.0) * 1e-3
            said = claim(State.ACTIVE, at_ms, tension=tension, reference=tension)
            given = {"tension": tension, "torque": tension, "mean_torque": tension}
            looks.append(seen(at_ms, said, rate=rate, **given))
        assert _first(judged(config, *looks)) == after_ms


def test_what_cables_stretch_by_is_of_the_looks_before(config: Config) -> None:
    """After a pause, while nothing was judged, and where a tension is not known, it is nothing."""
    space = config.robot.workspace
    moved = {key: tuple(end + 0.12 for end in getattr(space, key)) for key in ("x", "y", "z")}
    there = config.robot.model_copy(update={"workspace": space.model_copy(update=moved)})
    config = config.model_copy(update={"robot": there})
    speed, (_, compliance) = PlatformSpeed(config), _cables(config)

    def stretching(at_ms: float, newton: Any) -> Any:
        return speed.stretching(seen(at_ms, tension=np.broadcast_to(newton, N).astype(float)))

    assert not stretching(100.0, 40.0).any(), "the first"
    assert stretching(102.0, 50.0) == pytest.approx(5000.0 * compliance)
    assert stretching(104.0, 50.0) == pytest.approx(2500.0 * compliance)
    assert not stretching(106.0, 50.0).any()
    assert not stretching(122.5, 90.0).any(), "a pause"
    assert not stretching(124.5, 90.0).any(), "it is within two looks still"
    assert stretching(126.5, at(2, 94.0, 90.0)) == pytest.approx(at(2, 1000.0) * compliance)
    assert stretching(128.5, at(3, np.nan, 90.0)) == pytest.approx(0.0 * compliance)
    stretching(137.5, 90.0)
    stretching(146.5, 90.0)
    assert stretching(155.5, 99.0) == pytest.approx(500.0 * compliance), "as late as SUP-24 lets"


def test_a_drum_without_power_counts_from_the_slack_bound_on(config: Config) -> None:
    speed, slack = PlatformSpeed(config), config.control.tension.slack
    others = at(2, 0.0, 1.0) > 0.0
    for tension, turns in ((slack, True), (0.99 * slack, False)):
        look = seen(100.0, enabled=others, tension=at(2, tension, 45.0))
        assert (speed(look, at(2, -9.0))[0] > 0.1) is turns


@pytest.mark.parametrize(
    ("state", "after_ms"),
    [(State.REFERENCING, 6), (State.PRETENSION, 6), (State.HOLD, None), (State.ACTIVE, None)],
)
def test_drums_of_slack_cables_that_turn_with_the_others(
    config: Config, state: State, after_ms: int | None
) -> None:
    """By all drums the platform stands. Where no cable may be slack, a slack one is found."""
    tension = np.where(np.arange(N) < 4, 45.0, 2.0)
    looks = []
    for at_ms in np.arange(100.0, 120.0, 2.0):
        said = claim(state, at_ms, tension=tension)
        looks.append(seen(at_ms, said, tension=tension, rate=np.full(N, 0.6)))
    assert _first(judged(config, *looks)) == after_ms
    still = [replace(look, rate=np.full(N, 0.1)) for look in looks]
    assert _first(judged(config, *still)) is None
