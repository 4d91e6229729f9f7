"""Whether the supervisor can stop every drive, and only for a reason."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tonus.config import Config
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.drive import DriveError, DriveProfile
from tonus.config.schema.supervisor import (
    LARGEST,
    LARGEST_SHARES,
    LARGEST_SPREAD,
    SMALLEST,
    SMALLEST_SHARES,
    Supervisor,
)
from tonus.runtime.supervisor.judge import FORGETTING
from tonus.runtime.supervisor.wiring import Wiring, forces_of
from tonus.tools.check.feasibility import poses
from tonus.tools.check.finding import Finding

_KEY = "supervisor"
_NOTHING, _POWER_OFF = 0, 2
"""of 0x6007"""
_STANDING_MS = 100.0
"""in which a drum stands that was at the speed below when its drive lost the heartbeat. R"""
_LEAST_SPEED = 0.8
"""m/s: a drum may have it whatever ``stop.reel_in`` is. R"""
_LONGEST_BEAT_MS = 200
"""between heartbeats of a drive: those of one that is silent say that it was not pulled. R"""
_HEARTBEAT_LOST = 0x8130
_COMPARED = (0x6040, 0x6071)
"""controlword and target torque: the statusword tells of the one, the record of the other"""
_RAMP = "motor.quick_stop_rpm_s"
_SLOW_DOWN, _QUICK_STOP = 0x6084, 0x6085
"""ramps of a drive (CiA 402)"""
_FAULT_REACTION = 1
"""of 0x6007: as 0x605E says; the others that brake are as 0x605A says"""
_RAMP_BY_CODE = {0: None, 1: _SLOW_DOWN, 5: _SLOW_DOWN}
"""of 0x605A and 0x605E; any other, and where none is stated, is the quick stop's"""
_DRIFTING_S = 0.25
"""for which a tension may be away from its reference. R"""
_LEAST_SLACK = 0.2
"""of the tension while referencing. R"""
_IN_TICKS = ("frozen_frames", "logged_ticks")
_MOST_CONTACT = 1.4
"""times the limit of contact, found by a cell that was tared with what leaned on it. R"""
_MOST_LIFT = 3.0
"""times the platform's weight, in a passive stop whose lower cables do not pull. R: with 1.8 it was
thrown at 0.21 m/s, with 5.8 at 0.64 m/s"""


def check_supervisor(config: Config) -> Iterator[Finding]:
    """Whether there is one, and whether every drive is within its reach."""
    settings = config.supervisor
    if settings is None or settings.policy == "off":
        named = config.lab is not None or "supervisor.policy" in config.relaxed
        yield Finding(
            "supervisor",
            named,
            _KEY,
            "nothing but the daemon itself judges what the daemon does",
            "add supervisor: !include supervisor.yaml, or write supervisor.policy under relaxed",
        )
        return
    if config.lab is None:
        yield from _wide(config, settings)
        yield from _narrow(config, settings)
    if config.lab is not None or settings.policy != "require" or config.relay is not None:
        return
    read = Wiring(config)
    others = sorted(set(range(config.robot.cables)) - {axis.number for axis in read.axes})
    unread = sorted(set(range(config.robot.cells)) - {cell.number for cell in read.cells})
    if unread and not others:
        yield Finding(
            "supervisor",
            False,
            f"{_KEY}.policy",
            f"it does not read load cells {', '.join(map(str, unread))}, which are not on CAN: no "
            "bound of tension or contact is judged by them",
            "connect them to a channel of the drives; else write supervisor.policy under relaxed, "
            "and set it to use or off",
        )
    if others:
        yield Finding(
            "supervisor",
            False,
            f"{_KEY}.policy",
            f"without a relay it cannot stop axes {', '.join(map(str, others))}, not on CAN",
            "add sto_relay: !include sto_relay.yaml where no drive is on CAN; else write "
            "supervisor.policy under relaxed, and set it to use or off",
        )


def _wide(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """Bounds with which it would find a mistake too late, or never: its own, and those of the
    daemon that it judges by."""
    control = config.control
    envelope, stiffness, tension = control.envelope, control.stiffness, control.tension
    isolation = control.isolation
    tare, rise = control.sequence.tare_limit, stiffness.rise_rate
    slack_ms = envelope.over_tension_ticks * control.rates.period * 1e3
    space = config.robot.workspace
    middle = np.array([space.x, space.y, space.z]).mean(axis=1)
    away = np.abs(np.array(config.robot.geometry.frame) - middle)
    narrowest = float(away.max(axis=0).min())  # above a robot that hangs, its frame is a plane
    relay_ms = 0 if config.relay is None else config.relay.heartbeat_ms
    for key, value, bound, times in (
        *(
            (f"{_KEY}.{name}", getattr(settings, name), tension.pre, times)
            for name, times in LARGEST_SHARES.items()
        ),
        (f"{_KEY}.tension_stopping", settings.tension_stopping, tension.max, 1.5),
        (f"{_KEY}.contact_stopping", settings.contact_stopping, envelope.contact_limit, 1.5),
        (f"{_KEY}.contact_at_once", settings.contact_at_once, envelope.contact_limit, 3.0),
        (f"{_KEY}.speed_stopping", settings.speed_stopping, envelope.speed_limit, 10.0),
        (f"{_KEY}.speed_on_path", settings.speed_on_path, envelope.speed_limit, 3.0),
        (f"{_KEY}.speed_in_descent", settings.speed_in_descent, envelope.speed_limit, 4.0),
        (f"{_KEY}.spread", settings.spread, narrowest, LARGEST_SPREAD),
        (
            "control.sequence.tare_limit",
            tare,
            envelope.contact_limit,
            round(_MOST_CONTACT - settings.margin, 3),
        ),
        ("control.stiffness.rise_rate", rise, stiffness.maximum - stiffness.minimum, 10.0),
        ("control.isolation.tension_error", isolation.tension_error, tension.pre, 0.5),
        ("control.isolation.tension_error_s", isolation.tension_error_s, _DRIFTING_S, 1.0),
        ("control.envelope.over_tension_ticks", slack_ms, settings.patience_ms, 1.0),
        ("sto_relay.heartbeat_ms", relay_ms, settings.timeout_ms, 2.0),
    ):
        if value > times * bound:
            text = f"{value:g} is more than {times:g} times the {bound:g} that it is judged beside"
            remedy = f"set it to at most {times * bound:g}"
            if key.endswith("_ticks"):
                text, remedy = f"{text} (ms)", f"{remedy} ms in ticks"
            yield Finding("supervisor", False, key, text, remedy)
    for key, value, least, why in (
        (
            "control.tension.slack",
            tension.slack,
            _LEAST_SLACK * tension.referencing,
            "a cable counts as slack below {:g} N, which no cell shows in time",
        ),
        (
            "robot.response.force_cell_hz",
            config.response.force_cell_hz,
            1e3 / (2.0 * math.pi * settings.patience_ms),
            "cells of {:g} Hz show a force, by which it judges as well, after patience_ms only",
        ),
        (
            f"{_KEY}.quiet_s",
            settings.quiet_s,
            FORGETTING * 1e-3 * settings.disarmed_ms,
            "after {:g} s without power it forgets power that a disarmed daemon gives for less "
            "than disarmed_ms, again and again",
        ),
    ):
        if value < least:
            yield Finding(
                "supervisor", False, key, why.format(value), f"set it to at least {least:g}"
            )
    yield from _lift(config, settings)
    tick_ms = max(1.0, control.rates.period * 1e3)
    for name, largest in LARGEST.items():
        value = getattr(settings, name)
        most = math.floor(largest / tick_ms) if name in _IN_TICKS else largest
        if value > most:
            text = f"{value:g} would find a mistake too late, a robot may state {most:g}"
            yield Finding(
                "supervisor", False, f"{_KEY}.{name}", text, f"set it to at most {most:g}"
            )


def _lift(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """What the upper cables may pull with in a passive stop without being found."""
    robot, passive = config.robot, config.control.stop.passive_tension
    upward = poses(robot.geometry, np.array([robot.rest]), np.zeros((1, 3))).matrices[0, 2]
    share = float(upward[upward > 0.0].sum())
    lift, weight = (passive + settings.passive_torque) * share, robot.platform.mass * robot.gravity
    if lift > _MOST_LIFT * weight:
        most = _MOST_LIFT * weight / share - settings.passive_torque
        yield Finding(
            "supervisor",
            False,
            "control.stop.passive_tension",
            f"a passive stop whose lower cables do not pull lifts the platform of {weight:.0f} N "
            f"with {lift:.0f} N, and is not found",
            f"set it to at most {math.floor(10.0 * most) / 10.0:g}",
        )


def _longest_stop(config: Config) -> float:
    """s: from the far corner of the workspace along the path, with a load for as long as it waits,
    a descent that is late, a passive stop that does not come to rest, and its letting go."""
    sequence, stop, envelope = config.control.sequence, config.control.stop, config.control.envelope
    ranges = config.robot.workspace
    farthest = math.hypot(
        *(
            max(abs(end - at) for end in interval)
            for interval, at in zip((ranges.x, ranges.y, ranges.z), config.robot.rest, strict=True)
        )
    )
    cruise = envelope.speed_limit * envelope.speed_warning
    # The peak of a minimum-jerk motion is 15/8 of its mean speed.
    lowering = max(sequence.lower_s, 1.875 * (farthest / cruise + sequence.stop_s))
    waiting = sequence.hold_s + stop.landing_s + stop.passive_s
    return waiting + lowering + 3.0 * sequence.stop_s  # slowing down, and letting go twice


def _narrow(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """Bounds with which it would stop a robot whose daemon is right."""
    control = config.control
    envelope, freshness = control.envelope, control.freshness
    tick_ms = control.rates.period * 1e3
    margin = settings.margin
    stale_ms = (freshness.stale_stop_ticks + 1) * tick_ms + settings.period_ms
    missed_ms = (config.realtime.overrun_ticks + 1) * tick_ms
    brakes = [train.brake.closing_ms for train in config.robot.drive_trains if train.brake]
    shares = {name: share * control.tension.pre for name, share in SMALLEST_SHARES.items()}
    least: dict[str, tuple[float, str]] = {}
    for name, value, why in (
        *((each, value, "what one may reach") for each, value in (SMALLEST | shares).items()),
        (
            "axis_torque_ms",
            settings.stale_ms + settings.period_ms,
            "when a channel without answers loses its heartbeat alone (stale_ms and a look)",
        ),
        ("disarmed_ms", stale_ms + max(brakes, default=0.0), "what drives and brakes take"),
        ("tension_stopping", margin * control.tension.max, "the bound of a controlled robot"),
        ("contact_stopping", margin * envelope.contact_limit, "the bound of a controlled robot"),
        ("contact_at_once", settings.contact_stopping, "contact_stopping"),
        ("speed_stopping", margin * envelope.speed_limit, "the bound of a controlled robot"),
        ("speed_on_path", margin * envelope.speed_limit, "the bound of a controlled robot"),
        ("rotation_stopping", settings.rotation, "rotation"),
        ("stop_s", _longest_stop(config), "what a stop that waits and then fails may take"),
        ("patience_ms", missed_ms, "what the daemon may miss (realtime.overrun_ticks)"),
        ("stale_ms", stale_ms, "when the daemon stops for it (control.freshness.stale_stop_ticks)"),
    ):
        least[name] = max((value, why), least.get(name, (value, why)))
    for name, (bound, why) in least.items():
        value = getattr(settings, name)
        if value < bound:
            text = f"{value:g} is less than {why}, {bound:g}: it would stop a robot in order"
            yield Finding(
                "supervisor", False, f"{_KEY}.{name}", text, f"set it to at least {bound:g}"
            )
    yield from _ranges(config, settings)
    cutoff, bound = control.filters.force_cutoff_hz, _least_cutoff(config, settings)
    if cutoff < bound:
        yield Finding(
            "supervisor",
            False,
            "control.filters.force_cutoff_hz",
            f"with {cutoff:g} Hz a recorded contact is more than logged_tension behind the one on "
            "the bus for longer than patience_ms: SUP-11 would stop a robot in order",
            f"set it to at least {bound:g}",
        )


def _ranges(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """Whether load cells can say that a bound is broken: a number that is full says no more."""
    bound = max(settings.tension_stopping, settings.margin * config.control.tension.max)
    bound += config.control.sequence.tare_limit
    for bus in config.fieldbus.parts:
        for node in bus.nodes():
            forces = forces_of(bus.force_cell, len(node.cells)) if node.cells else []
            for (force, newton), number in zip(forces, node.cells, strict=False):
                most = math.inf if force.real else ((1 << force.bits - 1) - 1) * newton
                if most < bound:
                    yield Finding(
                        "supervisor",
                        False,
                        "fieldbus.force_cell",
                        f"load cell {number} says {most:g} N at most, and forces are judged up to "
                        f"{bound:g} N, its tare included: SUP-6 would never see them",
                        "use fewer decimal digits, or a PDO of 32 bits a cell",
                    )
                    return


def _least_cutoff(config: Config, settings: Supervisor) -> float:
    """Hz with which a contact that comes at once, as large as SUP-7 lets it be, is recorded within
    ``logged_tension`` after ``patience_ms``: of a step, a Butterworth filter of second order lacks
    exp(-a) (cos a + sin a) after sqrt(2) a / (2 pi f)."""
    contact = settings.margin * config.control.envelope.contact_limit
    grid = np.linspace(0.0, math.pi, 1001)
    lacking = np.exp(-grid) * (np.cos(grid) + np.sin(grid))
    after = float(np.interp(-settings.logged_tension / contact, -lacking, grid))
    return math.sqrt(2.0) * after / (2.0 * math.pi * settings.patience_ms * 1e-3)


def check_watches(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    """Whether the drives of a bus wait for it, and no shorter than they can."""
    settings = config.supervisor
    if settings is None or settings.policy == "off" or not bus.axis_places:
        return
    yield _times(settings)
    for key, profile in bus.every_profile.items():
        if not profile.watches_supervisor:
            yield Finding(
                "supervisor",
                config.lab is not None,
                f"{key}.watches_supervisor",
                f"{profile.name} has no second heartbeat consumer: the supervisor cannot stop it",
                "use a drive that has 0x1016:2",
            )
            continue
        yield _patience(settings, profile.heartbeat_margin_ms, profile.name)
        if not profile.scaling.torque == profile.scaling.position == "motor":
            yield Finding(
                "supervisor",
                True,
                f"{key}.scaling",
                f"only {profile.name} knows its scale: SUP-4, 5, 8, 10, 26 and the rates of SUP-3 "
                "do not judge it (docs/supervisor.md)",
                "",
            )
        if config.lab is None:
            if profile.heartbeat_ms > _LONGEST_BEAT_MS:
                yield Finding(
                    "supervisor",
                    False,
                    f"{key}.heartbeat_ms",
                    f"{profile.heartbeat_ms}: for so long a silent drive may be a pulled one",
                    f"set it to at most {_LONGEST_BEAT_MS}",
                )
            yield from _reacts(key, profile)
            yield from _stays_in_fault(key, profile)
            yield from _mapped(key, profile)


def check_ramps(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    """Whether the drums of a bus stand soon where their drives brake on the ramp that is written to
    them."""
    settings = config.supervisor
    speed = max(_LEAST_SPEED, config.control.stop.reel_in)
    keys = {id(profile): key for key, profile in bus.every_profile.items()}
    if settings is None or settings.policy == "off" or config.lab is not None:
        return
    for axis in sorted(bus.axis_places):
        profile, train = bus.profile(axis), config.robot.drive_trains[axis]
        index = _ramp_of(profile)
        if index is None or not profile.watches_supervisor:
            continue
        ramps = [each for each in profile.settings if each.index == index]
        if [each.quantity for each in ramps] != [_RAMP]:
            yield Finding(
                "supervisor",
                False,
                f"{keys[id(profile)]}.settings",
                f"{profile.name} brakes on a ramp when the heartbeat ends, which (0x{index:04X}) "
                + (f"is not {_RAMP} alone" if ramps else "is not written"),
                f"write it once, from the quantity {_RAMP}",
            )
            return
        ramp, metre = train.motor.quick_stop_rpm_s, train.drum.radius / train.gearbox.ratio
        least = speed / (_STANDING_MS * 1e-3) / metre * 60.0 / (2.0 * math.pi)
        if ramp is not None and ramp >= least:
            continue
        said = "is not stated" if ramp is None else f"is {ramp:g} rpm/s"
        yield Finding(
            "supervisor",
            False,
            "robot.motor.quick_stop_rpm_s",
            f"the ramp of axis {axis} {said}: after the heartbeat a drum at {speed:g} m/s takes "
            f"more than {_STANDING_MS:g} ms to stand",
            f"set it to at least {least:.0f}",
        )
        return


def _ramp_of(profile: DriveProfile) -> int | None:
    """The object of the ramp on which a drive brakes when the heartbeat ends; None: on none."""
    options, error = profile.options, _heartbeat_error(profile)
    code = options.abort_connection
    if error is not None and error.reaction is not None:
        if error.reaction == "fault_reaction":
            code = _FAULT_REACTION
        elif error.reaction != "abort_connection":
            return None
    if code in (None, _NOTHING, _POWER_OFF):
        return None
    reaction = options.fault_reaction if code == _FAULT_REACTION else options.quick_stop
    return _QUICK_STOP if reaction is None else _RAMP_BY_CODE.get(reaction, _QUICK_STOP)


def _times(settings: Supervisor) -> Finding:
    still_ms = settings.period_ms + settings.patience_ms + settings.timeout_ms
    longest_ms = settings.period_ms + settings.stopping_ms + settings.timeout_ms
    late_ms = settings.period_ms + settings.patience_ms
    return Finding(
        "supervisor",
        True,
        f"{_KEY}.timeout_ms",
        f"drives begin to stop {still_ms:g} ms after a mistake shows that may last patience_ms, "
        f"{longest_ms:g} ms after one that may last stopping_ms; {late_ms:g} ms later if it looks "
        "as late as SUP-24 lets it",
        "",
    )


def _reacts(key: str, profile: DriveProfile) -> Iterator[Finding]:
    """Whether a drive does anything when the heartbeat that it waits for ends."""
    code, error = profile.options.abort_connection, _heartbeat_error(profile)
    if code is None or code == _NOTHING:
        said = "is not stated" if code is None else "is 0: it does nothing"
        yield Finding(
            "supervisor",
            False,
            f"{key}.options.abort_connection",
            f"what {profile.name} does when it loses the supervisor (0x6007) {said}",
            "state a code with which it stops: " + _codes(profile),
        )
    if error is not None and error.reaction == "warning":
        yield Finding(
            "supervisor",
            False,
            f"{key}.errors",
            f"{profile.name} only warns when a heartbeat that it waits for ends (0x8130)",
            "use a drive that stops",
        )


def _stays_in_fault(key: str, profile: DriveProfile) -> Iterator[Finding]:
    """Whether a daemon that is wrong can enable the drive while the silence lasts: a consumer waits
    anew only from the next heartbeat on (CiA 301)."""
    error = _heartbeat_error(profile)
    if error is None or error.reset == "fault_reset":
        by_option = error is None or error.reaction == "abort_connection"
        code = profile.options.abort_connection
        if by_option and code not in (None, _NOTHING, _FAULT_REACTION):
            yield Finding(
                "supervisor",
                False,
                f"{key}.options.abort_connection",
                f"{profile.name} is not in FAULT after it lost the supervisor (0x6007 is "
                f"{code}): an ordinary controlword enables it again",
                f"set it to {_FAULT_REACTION}, or use a drive that has to be reset by NMT",
            )
        yield Finding(
            "supervisor",
            True,
            f"{key}.errors",
            f"a fault reset alone enables {profile.name} again after the supervisor has stopped "
            "it, also while the supervisor is silent (docs/supervisor.md)",
            "",
        )


def _mapped(key: str, profile: DriveProfile) -> Iterator[Finding]:
    """What a drive acts by and the supervisor does not compare with anything."""
    unread = [entry for entry in profile.rpdo if entry >> 16 not in _COMPARED]
    if len({entry >> 16 for entry in profile.rpdo}) < len(profile.rpdo):
        yield Finding(
            "supervisor",
            False,
            f"{key}.rpdo",
            f"{profile.name} is sent an object twice in every PDO, and acts by the second",
            "map each object once",
        )
    if unread:
        names = ", ".join(f"0x{entry >> 16:04X}" for entry in unread)
        yield Finding(
            "supervisor",
            False,
            f"{key}.rpdo",
            f"{profile.name} is sent {names} in every PDO, which the supervisor does not judge",
            "map controlword and target torque alone; write the others at bring-up, under settings",
        )


def _heartbeat_error(profile: DriveProfile) -> DriveError | None:
    found = (e for e in profile.errors if e.code <= _HEARTBEAT_LOST <= (e.last or e.code))
    return next(found, None)


def _codes(profile: DriveProfile) -> str:
    known = [each for each in profile.supported_options.abort_connection if each != _NOTHING]
    return ", ".join(map(str, known)) or f"{profile.name} has none, use another drive"


def _patience(settings: Supervisor, margin_ms: float, name: str) -> Finding:
    least = settings.period_ms + margin_ms
    return Finding(
        "supervisor",
        settings.timeout_ms >= least,
        f"{_KEY}.timeout_ms",
        f"drives wait {settings.timeout_ms} ms for its heartbeat, sent every {settings.period_ms} "
        f"ms; {name} needs {least:g} ms",
        f"set it to at least {least:g}",
    )
