"""A throwaway cycle, played from OFF to ACTIVE against a robot that does as it is told: so that
everything compiled is compiled, and every cache warm, before anything is armed."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.controllers import controller_class
from tonus.runtime.control.controllers.registry import is_foreign
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.errors import ControllerError
from tonus.runtime.safety.descent import Descent
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.faults import Faults
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing.latencies import Latencies

TICKS_AFTER_START = 50
_TRACKER_DIVISOR = 8
_DELAY_TICKS = 10
_STEP_S = 0.1
"""of each step of bringing up, a whole one's kernels and branches without its length"""
_UNSEEN = {
    "length_jump": 1e9,
    "tension_error": 1e9,
    "torque_error": 1e9,
    "travel": 1e9,
    "innovation": 1e9,
    "frozen_ticks": 10**9,
}
"""An isolation that finds nothing."""


def rehearse(config: Config, scenario: Scenario) -> bool:
    """Returns whether the cycle came as far as ACTIVE, which it does with a sound configuration.
    Raises `ControllerError` for a controller that is not ours and raises."""
    name = config.control.controller
    if not is_foreign(controller_class(name)):
        return _rehearse(config, scenario)
    try:
        return _rehearse(config, scenario)
    except ControllerError:
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
        raise ControllerError(f"controller {name}: raised {said}") from error


def _rehearse(config: Config, scenario: Scenario) -> bool:
    _watch(config)
    steps = ("tare_s", "referencing_settle_s", "pretension_s", "lift_s")
    brief = dict.fromkeys(steps, _STEP_S)
    # As many poses as make a reference.
    poses = config.control.sequence.referencing_poses + 1
    brief["referencing_average_s"] = poses * _TRACKER_DIVISOR * config.control.rates.period
    # This robot's drums do not turn, which neither the envelope nor the isolation would let pass.
    changes = {
        "sequence": config.control.sequence.model_copy(update=brief),
        "envelope": config.control.envelope.model_copy(update={"enabled": False}),
        "isolation": config.control.isolation.model_copy(update=_UNSEEN),
    }
    control = config.control.model_copy(update=changes)
    cycle = ControlCycle(config.robot, control, config.tracker, scenario.reference)
    image = ProcessImage(config.robot.cables)
    cycle.rehearse(image)
    Latencies.rehearse(cycle.record)
    image.axes["age"] = image.cells["age"] = 0
    image.tracker["position"] = config.robot.rest
    image.tracker["delay"] = _DELAY_TICKS * config.control.rates.period
    longest = 2.0 * sum(brief.values())
    left = TICKS_AFTER_START
    for tick in range(int(longest / config.control.rates.period)):
        state = cycle.sequence.state
        command = Operator.NONE
        if state is State.STANDBY:
            command = Operator.ARM
        elif state is State.HOLD:
            command = Operator.START
        elif state is State.ACTIVE:
            left -= 1
        if not left:
            return True
        enabled = image.commands["command"] == AxisCommand.ENABLE
        image.axes["state"] = np.where(
            enabled, AxisState.OPERATION_ENABLED, AxisState.SWITCH_ON_DISABLED
        )
        image.tracker["fresh"] = tick % _TRACKER_DIVISOR == 0
        image.cells["force"][: len(enabled)] = cycle.record.tension.reference
        cycle.step(image, tick, command)
    return False


def _watch(config: Config) -> None:
    """The envelope's own part, and a stop's."""
    control = config.control
    envelope = Envelope(
        control.envelope,
        control.tension,
        control.stiffness,
        config.robot,
        control.rates.period,
    )
    descent = Descent(config.robot, control, control.rates.period)
    cables = config.robot.cables
    every, still = np.ones(cables, dtype=bool), np.zeros(cables)
    descent.bound(ProcessImage(cables).commands["torque"], still, still, still, every, every)
    descent.guard.passive(still, every)
    faults = Faults(config.robot)
    faults.add(Fault.CELL_LOST, 0)
    descent.balanced(np.zeros((6, cables)), np.zeros(3), faults, 0.0)
    tension = np.full(cables, control.tension.pre)
    envelope(tension, 0.0, np.array(config.robot.home), np.zeros(3), every)
