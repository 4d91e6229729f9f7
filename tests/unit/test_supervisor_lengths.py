"""Recorded drum angles against positions on the bus, drives without power, and recorded references:
SUP-11, SUP-12 and SUP-5 of a record that goes on as if all were well."""

from __future__ import annotations

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
    seen,
)
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement, Supervisor
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.judge import Violation
from tonus.runtime.supervisor.lengths import Lengths
from tonus.runtime.supervisor.record import CONTROLLED
from tonus.runtime.supervisor.wiring import Wiring

RADIUS = load("config/can.yaml")[0].robot.drum_radius
"""m (n,)"""
SLOW_MS = 11
"""behind which a record may be: 5 of patience, 2 of a look, 4 of records"""


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


@pytest.fixture
def settings(config: Config) -> Supervisor:
    assert config.supervisor is not None
    return config.supervisor


@pytest.fixture
def lengths(config: Config, settings: Supervisor) -> Lengths:
    return Lengths(Wiring(config).axes, settings, MS)


def axes(config: Config) -> list[int]:
    return [axis.number for axis in Wiring(config).axes]


def said(metre: Any, state: State = State.ACTIVE) -> Any:
    """A record with these lengths (n,) or one for all."""
    return claim(state, angle=np.full(N, metre) / RADIUS)


def test_both_begin_anywhere(lengths: Lengths) -> None:
    assert np.isnan(lengths(0, np.full(N, 0.3), None)).all()
    assert lengths(0, np.full(N, 0.3), said(0.1)) == pytest.approx(np.zeros(N), abs=1e-12)
    assert lengths(20 * MS, np.full(N, 0.3), said(0.102)) == pytest.approx(np.full(N, 0.002))
    assert lengths(40 * MS, np.full(N, 0.3), said(0.097)) == pytest.approx(np.full(N, 0.003))
    assert lengths(60 * MS, np.full(N, 0.301), said(0.101)) == pytest.approx(np.zeros(N), abs=1e-12)


@pytest.mark.parametrize("state", State)
def test_they_begin_anew_until_the_robot_is_controlled(lengths: Lengths, state: State) -> None:
    lengths(0, np.full(N, 0.3), said(0.1, state))
    lengths(20 * MS, np.full(N, 0.3), said(0.11, state))
    off = lengths(40 * MS, np.full(N, 0.3), said(0.11))
    expected = 0.01 if state in CONTROLLED else 0.0
    assert off == pytest.approx(np.full(N, expected), abs=1e-12)


@pytest.mark.parametrize(("metre", "anew"), [(0.0001, True), (-0.0001, True), (0.00011, False)])
def test_they_begin_anew_only_where_the_drum_stands(
    lengths: Lengths, metre: float, anew: bool
) -> None:
    """Within the time for which a record may be behind."""
    state = State.STANDBY
    lengths(0, np.zeros(N), said(0.1, state))
    lengths(18 * MS, np.zeros(N), said(0.1, state))
    lengths(20 * MS, np.full(N, metre), said(0.15, state))
    off = lengths(21 * MS, np.full(N, metre), said(0.15))
    expected = 0.0 if anew else 0.05 - metre
    assert off == pytest.approx(np.full(N, expected), abs=1e-12)


@pytest.mark.parametrize("metre", [0.02, -0.02])
def test_how_far_a_record_may_be_behind(lengths: Lengths, metre: float) -> None:
    """The platform moves for some time, in a record that stands still."""
    lengths(0, np.zeros(N), said(0.0))
    for ms in range(1, SLOW_MS + 1):
        off = lengths(ms * MS, np.full(N, metre), said(0.0))
        assert off == pytest.approx(np.zeros(N), abs=1e-12)
    assert lengths((SLOW_MS + 1) * MS, np.full(N, metre), said(0.0)) == pytest.approx(
        np.full(N, abs(metre))
    )


def test_each_cable_by_itself(config: Config, lengths: Lengths) -> None:
    """Rows are in the order of the wiring, records in that of the axes."""
    recorded = np.arange(N) * 0.01
    bus = recorded[axes(config)]
    assert lengths(0, bus, said(recorded)) == pytest.approx(np.zeros(N), abs=1e-12)
    recorded[6] += 0.004
    off = lengths(20 * MS, bus, said(recorded))
    assert off == pytest.approx(at(axes(config).index(6), 0.004), abs=1e-12)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("first", [State.STANDBY, State.HOLD])
def test_an_angle_that_is_no_number(
    config: Config, lengths: Lengths, value: float, first: State
) -> None:
    row = axes(config).index(2)
    recorded = at(2, value, 0.1)
    off = lengths(0, np.full(N, 0.3), said(recorded, first))
    assert off[row] == np.inf
    assert np.delete(off, row) == pytest.approx(np.zeros(N - 1), abs=1e-12)
    lengths(20 * MS, np.full(N, 0.3), said(0.1))
    off = lengths(40 * MS, np.full(N, 0.3), said(0.12))
    assert off[row] == pytest.approx(0.02), "it begins with the first that is one"


def test_a_position_that_was_never_received(config: Config, lengths: Lengths) -> None:
    unknown = at(3, float("nan"), 0.3)
    off = lengths(0, unknown, said(0.1))
    assert np.isnan(off[3])
    assert np.isnan(lengths(20 * MS, unknown, said(at(axes(config)[3], np.nan, 0.1)))[3])
    for ms in (40, 60):
        off = lengths(ms * MS, np.full(N, 0.3), said(0.1))
    assert off == pytest.approx(np.zeros(N), abs=1e-12)


def test_lengths_of_frames_and_record(config: Config) -> None:
    """Through the observer, from increments and radians, signs and gearboxes included."""
    stage = Stage(config)
    for k in range(30):
        metre = 0.001 * k
        stage.tick(k * MS, newton=45.0, metre=metre, force=45.0)
        found = stage.observe(k * MS, stage.heard, [said(metre + 0.2)])
    assert found.off_bus == pytest.approx(np.zeros(N), abs=1e-5)
    found = stage.observe(30 * MS, stage.heard, [said(0.25)])
    assert found.off_bus == pytest.approx(np.full(N, 0.021), abs=1e-5)


def ended(config: Config, for_ms: float, state: State, **given: Any) -> Violation | None:
    """The verdict when a condition has lasted; ``reference`` and the like are the record's."""
    names = ("reference", "failed", "stop_mode", "tension")
    record = {name: given.pop(name) for name in names if name in given}
    looks = [seen(ms, claim(state, ms, **record), **given) for ms in (100.0, 100.0 + for_ms)]
    return judged(config, *looks)[-1]


@pytest.mark.parametrize("state", State)
def test_a_length_that_is_not_that_of_the_bus(config: Config, state: State) -> None:
    given = {"off_bus": at(4, 0.00051)}
    found = ended(config, 2.0, state, **given)
    if state not in CONTROLLED:
        assert found is None or found.requirement is not Requirement.MEASURED_LOGGED
        return
    assert found == Violation(Requirement.MEASURED_LOGGED, 4, 0.00051)
    assert ended(config, 1.9, state, **given) is None
    assert ended(config, 4.0, state, off_bus=at(4, 0.0005)) is None
    assert ended(config, 4.0, state, off_bus=np.full(N, np.nan)) is None
    assert ended(config, 4.0, state, enabled=np.arange(N) != 4, **given) is None


POWERED = [(state, StopMode.NONE) for state in CONTROLLED[1:]]
POWERED.append((State.SAFE_STOP, StopMode.ON_PATH))


@pytest.mark.parametrize(("state", "mode"), POWERED)
def test_a_drive_without_power_whose_cable_is_not_given_up(
    config: Config, state: State, mode: StopMode
) -> None:
    off: dict[str, Any] = {"enabled": np.arange(N) != 3, "stop_mode": mode}
    if state in (State.HOLD, State.ACTIVE):
        off["reference"] = np.full(N, 45.0)
    found = ended(config, 20.0, state, **off)
    assert found == Violation(Requirement.DISARMED, 3, 45.0)
    assert ended(config, 19.9, state, **off) is None
    found = ended(config, 30.0, state, failed=np.arange(N) == 3, **off)
    if state is State.SAFE_STOP:
        assert found is None
    else:
        assert found is not None
        assert found.requirement is Requirement.ORDERS, "a cable that is given up is a stop's"
    for reference in (0.0, 1e-6):
        off["reference"] = at(3, reference, 45.0)
        found = ended(config, 30.0, state, **off)
        if state is State.SAFE_STOP and reference == 0.0:
            assert found is None, "at the end of a stop none is asked"
        else:
            assert found == Violation(Requirement.DISARMED, 3, reference)


@pytest.mark.parametrize(("state", "mode"), POWERED)
def test_drives_of_a_channel_whose_heartbeat_has_ended(
    config: Config, state: State, mode: StopMode
) -> None:
    """They go on for `timeout_ms`, and the daemon's own stop of the others begins after that."""
    ended_alone = np.isin(np.arange(N), (3, 5))
    off: dict[str, Any] = {"enabled": ~ended_alone, "beating": ~ended_alone, "stop_mode": mode}
    if state in (State.HOLD, State.ACTIVE):
        off["reference"] = np.full(N, 45.0)
    assert config.supervisor is not None
    for_ms = 20.0 + config.supervisor.timeout_ms
    assert ended(config, for_ms, state, **off) == Violation(Requirement.DISARMED, 3, 45.0)
    assert ended(config, for_ms - 0.1, state, **off) is None
    off["enabled"] = off["enabled"] & (np.arange(N) != 1)
    found = ended(config, 20.0, state, **off)
    assert found == Violation(Requirement.DISARMED, 1, 45.0), "one that has its heartbeat"


@pytest.mark.parametrize(
    ("state", "mode"),
    [
        (State.REFERENCING, StopMode.NONE),
        (State.SAFE_STOP, StopMode.DESCENT),
        (State.SAFE_STOP, StopMode.PASSIVE),
    ],
)
def test_a_drive_without_power_where_others_may_do_without_it(
    config: Config, state: State, mode: StopMode
) -> None:
    off: dict[str, Any] = {"enabled": np.arange(N) != 3, "stop_mode": mode}
    assert ended(config, 30.0, state, tension=np.full(N, 45.0), **off) is None


def test_without_power_is_never_found_before_the_general_patience() -> None:
    patient = STRICT | {"supervisor.patience_ms": 30, "supervisor.timeout_ms": 50}
    config = load("config/can.yaml", overrides=patient)[0]
    off = {"enabled": np.arange(N) != 3}
    assert ended(config, 31.9, State.ACTIVE, **off) is None
    assert ended(config, 32.0, State.ACTIVE, **off) == Violation(Requirement.DISARMED, 3, 45.0)


def test_a_recorded_reference_at_its_bounds_is_within_them(
    config: Config, settings: Supervisor
) -> None:
    tension = config.control.tension
    for bound in (tension.min / settings.margin, tension.max * settings.margin):
        there = at(5, min(bound, tension.max), 45.0)
        record = {"tension": there, "reference": at(5, bound, 45.0)}
        looks = [
            seen(ms, claim(State.HOLD, ms, **record), tension=there, torque=there)
            for ms in (100.0, 110.0)
        ]
        assert judged(config, *looks)[-1] is None
