"""The reaction to an exception in control: the cycle's passive fallback in each tick until no drum
turns, then the drives are disabled."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.root import Config
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.safety.firewall import Part
from tonus.runtime.states import State


class Fallback:
    """`step` takes the place of `ControlCycle.act` until it is `over`."""

    def __init__(self, config: Config, cycle: ControlCycle, part: Part) -> None:
        """``part`` guards the cycle's own fallback."""
        settings, period = config.operation.fallback, config.control.rates.period
        self._cycle, self._part = cycle, part
        self._still = settings.rest_travel / config.robot.drum_radius
        self._rest_ticks = max(1, round(settings.rest_s / period))
        self._longest_ticks = round(settings.longest_s / period)
        self._off_ticks = max(1, round(settings.off_s / period))
        self._stale_ticks = config.control.freshness.stale_stop_ticks
        self._anchor = np.full(len(config.robot.geometry.frame), np.nan)
        self._began = self._since = 0
        self._disabling: int | None = None
        """tick of the command to disable the drives"""
        self.active = self.over = False

    def begin(self, reason: str, tick: int) -> None:
        """Control raised in ``tick``, for ``reason``."""
        self.active = True
        self._began = self._since = tick
        self._cycle.sequence.abandon(reason, tick)

    def step(self, image: ProcessImage, tick: int, *, disable: bool) -> None:
        """Commands of one tick; ``disable``: at once, by an emergency stop."""
        commands = image.commands
        failures = self._part.failures
        self._part.call(self._cycle.fall_back, image, tick)
        if self._part.failures > failures or not np.isfinite(commands["torque"]).all():
            commands["torque"] = 0.0
        if self._disabling is None and (disable or self._rests(image, tick)):
            self._disabling = tick
        if self._disabling is None:
            return
        commands["command"], commands["torque"] = AxisCommand.DISABLE, 0.0
        off = image.axes["state"] != AxisState.OPERATION_ENABLED
        silent = image.axes["age"] > self._stale_ticks
        waited = tick - self._disabling
        if waited and ((off | silent).all() or waited >= self._off_ticks):
            self.over = True
            self._cycle.sequence.state = State.FAULT

    def _rests(self, image: ProcessImage, tick: int) -> bool:
        """No drum that answers has turned for a while; or it has taken too long; or no drive is
        enabled at all."""
        axes = image.axes
        if (axes["state"] != AxisState.OPERATION_ENABLED).all():
            return True
        fresh = axes["age"] <= self._stale_ticks
        angle = np.where(fresh, axes["angle"], self._anchor)
        still = np.abs(angle - self._anchor) <= self._still
        if not (still | ~fresh).all():
            self._anchor, self._since = angle, tick
        rested = tick - self._since >= self._rest_ticks
        return rested or tick - self._began >= self._longest_ticks
