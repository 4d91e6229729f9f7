"""What one trial came to: every indicator of its kind, against the plant's truth.

Formulas, windows and time origins: docs/paper.md, "Indicators". A trial gives only the indicators
that exist for it, so none is ever nan.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.scenario import Path, Press, Sine
from tonus.runtime.control.reference import trajectory
from tonus.runtime.signals import Grade
from tonus.tools.paper import indicators as formula
from tonus.tools.paper.case import Kind
from tonus.tools.paper.forces import cable_wrench
from tonus.tools.paper.trial import Trial

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indicators = dict[str, float]

NEEDED_CYCLE = (
    *("state.scenario_time", "pose.desired_position", "stiffness.k_eq", "stiffness.measured"),
    *("tension.reference", "wrench.commanded", "wrench.deficit", "drives.torque_command"),
    *("envelope.grade", "energy.stiffening", "energy.dissipated", "energy.tank"),
)
NEEDED_TRUTH = (
    *("position", "quaternion", "velocity", "tension", "drum_rate", "current", "load"),
    *("contact_force", "contact_penetration", "platform_power", "electrical_power"),
    *("friction_losses", "cable_losses", "copper_losses"),
)
"""What of a trial is read here; more need not be kept."""
BAND = 0.02
"""of the step, within which it counts as settled"""
FINAL_S = 0.2
"""s at the end of a stretch whose mean is its final value"""
REACTION = 0.63
"""share of its rise at which K_eq has reacted"""
LEAST_RISE = 0.01
"""of K0: less is no rise"""
LOW_HZ, HIGH_HZ = 0.0, 10.0
_WHOLE = 0.999
_TRACE_ROWS = 3000
_STILL = 2.0e-4
"""m/s under which a displaced platform is taken to stand"""


def measure(trial: Trial) -> Indicators:
    """All indicators of a trial by name, in SI units or, where the name says so, in %, degrees or
    ticks. Empty for a trial without a tick."""
    if len(trial.time) < 2:
        return {}
    found = dict(_safety(trial))
    window = _window(trial)
    if window.any():
        found.update(_common(trial, window))
        found.update(_OF_KIND[trial.run.case.kind](trial, window))
    return {name: float(value) for name, value in found.items() if np.isfinite(value)}


def traces(trial: Trial) -> dict[str, Array]:
    """Curves for figures and for R^2, at equal steps, 3000 rows at most:

    time (m,), error, position, velocity, load and cable_force (m, 3), k_eq, contact, contact_wanted
    and way (m,): the true position along the test's direction.
    """
    stride = -(-len(trial.time) // _TRACE_ROWS)
    every = slice(None, None, stride)
    truth = trial.truth
    wrench = cable_wrench(
        trial.config.robot.geometry,
        truth["position"][every],
        truth["quaternion"][every],
        truth["tension"][every],
    )
    home = np.array(trial.config.robot.home)
    curves = {
        "time": trial.time[every],
        "scenario_time": trial.cycle["state.scenario_time"][every],
        "position": truth["position"][every] - home,
        "desired": trial.cycle["pose.desired_position"][every] - home,
        "velocity": truth["velocity"][every],
        "load": truth["load"][every][:, :3],
        "cable_force": wrench[:, :3],
        "k_eq": trial.cycle["stiffness.k_eq"][every],
        "contact": truth["contact_force"][every],
        "contact_wanted": _push(trial)[every],
        "tension": truth["tension"][every],
    }
    return {name: np.asarray(values, dtype=np.float32) for name, values in curves.items()}


def _window(trial: Trial) -> Mask:
    """(n,) the ticks that are judged: without the fade-in, and whole periods."""
    reference = trial.run.case.scenario.reference
    time = trial.cycle["state.scenario_time"]
    if trial.run.case.kind is Kind.SINE and isinstance(reference, Sine):
        return _periods(time, reference.fade, reference.frequency)
    if trial.run.case.kind is Kind.PRESS and isinstance(reference, Press):
        begin = reference.approach + reference.fade
        return _periods(time, begin, reference.frequency)
    return np.ones(len(time), dtype=bool)


def _periods(time: Array, begin: float, frequency: float) -> Mask:
    count = np.floor((float(time[-1]) - begin) * frequency + 1e-6)
    return np.asarray((time >= begin) & (time < begin + count / frequency))


def _safety(trial: Trial) -> Indicators:
    """Over the whole trial, whatever became of it."""
    control, truth, robot = trial.config.control, trial.truth, trial.config.robot
    tension, k_eq = truth["tension"], trial.cycle["stiffness.k_eq"]
    slack = (tension < control.tension.slack).any(axis=1)
    box = np.array([robot.workspace.x, robot.workspace.y, robot.workspace.z])
    outside = ((truth["position"] < box[:, 0]) | (truth["position"] > box[:, 1])).any(axis=1)
    law = control.stiffness
    lab = trial.config.lab
    touchable = trial.run.case.scenario.lab.phantom or (lab and lab.phantom)
    stray = (k_eq < law.minimum * _WHOLE) | (k_eq > law.maximum / _WHOLE)
    violated = (
        slack
        | (tension > control.tension.max).any(axis=1)
        | (truth["contact_force"] > control.envelope.contact_limit)
        | (formula.norms(truth["velocity"]) > control.envelope.speed_limit)
        | outside
        | stray
    )
    touched = {"contact_peak": truth["contact_force"].max()} if touchable else {}
    return {
        **touched,
        "slack_ticks": slack.sum(),
        "violation_ticks": violated.sum(),
        "amber_percent": 100.0 * (trial.cycle["envelope.grade"] != Grade.GREEN).mean(),
        "violation_longest": formula.longest_run(violated),
        "tension_low_ticks": (tension < control.tension.min).any(axis=1).sum(),
        "tension_min": tension.min(),
        "tension_max": tension.max(),
        "k_eq_outside_ticks": stray.sum(),
        "k_eq_min": k_eq.min(),
        "k_eq_max": k_eq.max(),
        "deficit_max": trial.cycle["wrench.deficit"].max(),
        "envelope_enabled": control.envelope.enabled,
        "duration": trial.time[-1],
    }


def _common(trial: Trial, window: Mask) -> Indicators:
    cycle, truth = trial.cycle, trial.truth
    chosen = np.flatnonzero(window)
    span = slice(chosen[0], chosen[-1] + 1)
    time = trial.time[span]
    reference, tension = cycle["tension.reference"][span], truth["tension"][span]
    off = tension - reference
    share = off / np.maximum(reference, trial.config.control.tension.slack)
    stiffening = cycle["energy.stiffening"][span]
    law = trial.config.control.stiffness
    wanted = np.array(cycle["wrench.commanded"][span])
    true = cable_wrench(
        trial.config.robot.geometry, truth["position"][span], truth["quaternion"][span], tension
    )
    torque = np.diff(cycle["drives.torque_command"][span], axis=0) / np.diff(time)[:, None]
    k_eq = cycle["stiffness.k_eq"][span]
    found = {
        "position_rmse": formula.rms(_error(trial)[span]),
        "tension_rmse": np.sqrt((off**2).mean()),
        "tension_percent": 100.0 * np.sqrt((share**2).mean()),
        "tension_percent_max": 100.0 * np.abs(share).max(),
        "eq13_broken_percent": 100.0 * (stiffening > cycle["energy.dissipated"][span]).mean(),
        "tank_min": cycle["energy.tank"][span].min(),
        "tension_spread": tension.std(axis=1).mean(),
        "force_rmse": formula.rms(wanted[:, :3] - true[:, :3]),
        "moment_rmse": formula.rms(wanted[:, 3:] - true[:, 3:]),
        "k_eq_mean": k_eq.mean(),
        "stiffness_deviation_percent": 100.0
        * formula.rms(cycle["stiffness.measured"][span] - k_eq)
        / law.base,
        "effort": np.sqrt((torque**2).mean()),
        "energy_dissipated": _lost(trial, span),
        "window": time[-1] - time[0],
    }
    spent = formula.energy(time, truth["electrical_power"][span])
    if spent > 0.0:
        gained = formula.energy(time, truth["platform_power"][span])
        found["efficiency_percent"] = 100.0 * gained / spent
    drives = _drive_efficiency(trial, span)
    if drives is not None:
        found["drive_efficiency_percent"] = drives
    return found


def _drive_efficiency(trial: Trial, span: slice) -> float | None:
    """%: what each cable gets from its drum over what its motor gets, drive by drive, where the
    motor drives. None where no motor does."""
    truth, robot, lab = trial.truth, trial.config.robot, trial.config.lab
    if lab is None:
        return None
    current, rate = truth["current"][span], truth["drum_rate"][span]
    shaft = robot.torque_per_amp * current * rate
    electrical = shaft + lab.plant.winding_resistance * current**2
    cable = truth["tension"][span] * robot.drum_radius * rate
    driving = (shaft > 0.0) & (cable > 0.0)
    spent = float(electrical[driving].sum())
    return 100.0 * float(cable[driving].sum()) / spent if spent > 0.0 else None


def _lost(trial: Trial, span: slice) -> float:
    kinds = ("friction_losses", "cable_losses", "copper_losses")
    return float(sum(trial.truth[kind][span][-1] - trial.truth[kind][span][0] for kind in kinds))


def _error(trial: Trial) -> Array:
    """(n, 3) m: desired less true position."""
    return np.asarray(trial.cycle["pose.desired_position"] - trial.truth["position"], np.float64)


def _push(trial: Trial) -> Array:
    """(n,) N: the contact force a press asks for, 0 otherwise."""
    reference = trial.run.case.scenario.reference
    time = trial.cycle["state.scenario_time"]
    if not isinstance(reference, Press):
        return np.zeros(len(time))
    wanted = trajectory(reference)
    return np.array([float(np.linalg.norm(wanted.push(float(t)))) for t in time])


def _sine(trial: Trial, window: Mask) -> Indicators:
    reference = trial.run.case.scenario.reference
    if not isinstance(reference, Sine):
        return {}
    time = trial.cycle["state.scenario_time"][window]
    way = np.array(reference.direction) / np.linalg.norm(reference.direction)
    wanted = trial.cycle["pose.desired_position"][window] @ way
    got = trial.truth["position"][window] @ way
    span = float(time[-1] - time[0]) + trial.config.control.rates.period
    first = np.flatnonzero(window)
    lost = _lost(trial, slice(first[0], first[-1] + 1))
    gain = abs(formula.phasor(time, got, reference.frequency))
    return {
        "phase_lag_deg": formula.phase_lag(time, wanted, got, reference.frequency),
        "amplitude_error_percent": 100.0 * (gain / reference.amplitude - 1.0),
        "energy_per_period": lost / (span * reference.frequency),
        "periods": round(span * reference.frequency),
        "frequency_hz": reference.frequency,
        "amplitude": reference.amplitude,
    }


def _move(trial: Trial, window: Mask) -> Indicators:  # noqa: ARG001
    """Each step of a path that a pause follows; the mean and the worst of them."""
    reference = trial.run.case.scenario.reference
    if not isinstance(reference, Path):
        return {}
    time, home = trial.cycle["state.scenario_time"], np.array(trial.config.robot.home)
    position = trial.truth["position"] - home
    begin, start = 0.0, np.zeros(3)
    settled: list[float] = []
    beyond: list[float] = []
    steady: list[float] = []
    unsettled = 0
    for waypoint in reference.waypoints:
        target, end = np.array(waypoint.position), begin + waypoint.duration + waypoint.pause
        step = float(np.linalg.norm(target - start))
        inside = (time >= begin) & (time < end)
        if waypoint.pause > FINAL_S and step > 0.0 and time[-1] >= end - FINAL_S and inside.any():
            final = position[inside & (time >= end - FINAL_S)].mean(axis=0)
            took = _settled(time[inside], position[inside] - final, BAND * step, begin)
            travel = (position[inside] - start) @ (target - start) / step
            reached = float((final - start) @ (target - start)) / step
            beyond.append(100.0 * max(float(travel.max()) - reached, 0.0) / step)
            steady.append(float(np.linalg.norm(final - target)))
            if took is None:
                unsettled += 1
            else:
                settled.append(took)
        begin, start = end, target
    found: Indicators = {}
    if beyond:
        found["overshoot_percent"] = float(np.mean(beyond))
        found["overshoot_worst_percent"] = max(beyond)
        found["steady_error"] = float(np.mean(steady))
        found["unsettled"] = float(unsettled)
    if settled and not unsettled:
        found["settling"] = float(np.mean(settled))
        found["settling_worst"] = max(settled)
    return found


def _settled(time: Array, error: Array, band: float, origin: float) -> float | None:
    """`settling_time`, but None too where it came inside only while the final value was taken:
    then there is none."""
    took = formula.settling_time(time, error, band, origin)
    return None if took is None or origin + took > float(time[-1]) - FINAL_S else took


def _load(trial: Trial, window: Mask) -> Indicators:  # noqa: ARG001
    """Ramp and step: from the true onset of the load until it goes."""
    load = formula.norms(trial.truth["load"][:, :3])
    highest = float(load.max())
    if highest <= 0.0:
        return {}
    onset = int(np.argmax(load > 0.0))
    full = int(np.argmax(load >= _WHOLE * highest))
    gone = np.flatnonzero(load[full:] < _WHOLE * highest)
    end = full + int(gone[0]) if len(gone) else len(load)
    time = trial.time
    final_from = max(end - round(FINAL_S / trial.config.control.rates.period), full)
    if onset == 0 or end - onset < 3 or final_from >= end:
        return {}
    error = _error(trial)
    final = error[final_from:end].mean(axis=0)
    stretch = slice(onset, end)
    peak = float(formula.norms(error[stretch]).max())
    # The first tick whose load is not nothing is the first after the onset.
    begin, origin = float(time[onset - 1]), onset if trial.run.case.kind is Kind.STEP else full
    found = {
        "load_peak": highest,
        "load_deviation_peak": peak,
        "load_deviation_end": float(np.linalg.norm(final)),
        "k_eq_at_end": trial.cycle["stiffness.k_eq"][final_from:end].mean(),
        "vibration_0_10hz": formula.band_rms(
            time[stretch], trial.truth["velocity"][stretch], LOW_HZ, HIGH_HZ
        ),
    }
    took = _settled(time[origin:end], error[origin:end] - final, BAND * peak, float(time[origin]))
    if took is not None:
        found["load_settling"] = took
    found.update(_forces_under_load(trial, onset, stretch))
    k_eq, base = trial.cycle["stiffness.k_eq"], trial.config.control.stiffness.base
    plateau = float(np.median(k_eq[final_from:end]))
    if trial.run.case.kind is Kind.STEP and plateau - float(k_eq[onset - 1]) > LEAST_RISE * base:
        found["reaction"] = formula.rise_time(
            time[:end], k_eq[:end].astype(np.float64), begin, plateau, REACTION
        )
    return found


def _forces_under_load(trial: Trial, onset: int, stretch: slice) -> Indicators:
    """The cables' resultant: by how much it goes beyond the load it has to balance."""
    truth = trial.truth
    at = slice(onset - 1, stretch.stop)
    force = cable_wrench(
        trial.config.robot.geometry,
        truth["position"][at],
        truth["quaternion"][at],
        truth["tension"][at],
    )[:, :3]
    return {"force_peak": float(formula.norms(force - force[0]).max())}


def _contact(trial: Trial, window: Mask) -> Indicators:  # noqa: ARG001
    force = trial.truth["contact_force"]
    touched = np.flatnonzero(force > 0.0)
    if not len(touched):
        return {}
    peak, first = int(force.argmax()), int(touched[0])
    speed = formula.norms(trial.truth["velocity"])
    return {
        "contact_speed": float(speed[first]),
        "contact_depth": float(trial.truth["contact_penetration"].max()),
        "k_eq_at_contact_peak": float(trial.cycle["stiffness.k_eq"][peak]),
        "contact_final": float(force[trial.time >= trial.time[-1] - FINAL_S].mean()),
    }


def _press(trial: Trial, window: Mask) -> Indicators:
    reference = trial.run.case.scenario.reference
    if not isinstance(reference, Press):
        return {}
    wanted, got = _push(trial)[window], trial.truth["contact_force"][window]
    found = {"contact_force_rmse": formula.rms(got - wanted)}
    if reference.swing > 0.0:
        time = trial.cycle["state.scenario_time"][window]
        found["force_phase_lag_deg"] = formula.phase_lag(time, wanted, got, reference.frequency)
    return found


def _slope(trial: Trial, window: Mask) -> Indicators:  # noqa: ARG001
    """Eq. (8): force of the port that moves the platform against the way it has moved it."""
    position = trial.truth["position"] - trial.truth["position"][0]
    farthest = position[int(formula.norms(position).argmax())]
    length = float(np.linalg.norm(farthest))
    if length <= 0.0:
        return {}
    way = farthest / length
    x, force = position @ way, trial.truth["load"][:, :3] @ way
    rate = trial.truth["velocity"] @ way
    moving = (np.abs(rate) > _STILL) & (np.abs(force) > 0.0)
    if moving.sum() < 3 or float(np.ptp(x[moving])) <= 0.0:
        return {}
    rise, fit = formula.slope(x[moving], force[moving])
    found = {"slope": rise, "slope_fit": fit, "travel": float(np.ptp(x[moving]))}
    for name, part in (("loading", moving & (rate > 0.0)), ("unloading", moving & (rate < 0.0))):
        if part.sum() > 2:
            found[f"slope_{name}"] = formula.slope(x[part], force[part])[0]
    if float(trial.truth["contact_force"].max()) > 0.0:
        against = np.abs(trial.truth["contact_force"])[moving]
        found["slope_phantom"] = abs(formula.slope(x[moving], against)[0])
    return found


def _nothing(trial: Trial, window: Mask) -> Indicators:  # noqa: ARG001
    return {}


_OF_KIND: dict[Kind, Callable[[Trial, Mask], Indicators]] = {
    Kind.SLOPE: _slope,
    Kind.SINE: _sine,
    Kind.MOVE: _move,
    Kind.RAMP: _load,
    Kind.STEP: _load,
    Kind.CONTACT: _contact,
    Kind.PRESS: _press,
    Kind.HOLD: _nothing,
}
