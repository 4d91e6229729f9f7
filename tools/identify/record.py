"""One log as what the robot measured, all of it at the same instants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_erosion
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from tonus.config.schema.root import Config
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_TOPICS = ("timing", "state", "drives", "force_cells", "tracker", "pose", "stiffness", "tension")
_FEWEST_POSES = 100
_SMOOTHING_HZ = 10.0
"""what is kept for drums and tilts: ten times the fastest excitation of the paper"""
_EDGE_S = 0.1
"""how far that filter carries what happens at one instant"""
UNLIKE_DELAY_TICKS = 1.0
"""Encoders, drives, cells and tracker filter what they tell, and a log does not say how long that
takes. What this much between them would change is part of every interval it matters for."""
BLOCK_S = 0.25
"""stretches taken as independent: longer than any filter here, shorter than any excitation"""


@dataclass(frozen=True)
class Record:
    """Rows are ticks without gaps; what a row holds was sampled at its `time`."""

    path: Path
    log: Log
    config: Config
    period: float
    time: Array
    """s (n,), of the SYNC at which drives and cells sampled"""
    state: NDArray[np.uint8]
    angle: Array
    """rad (n, cables)"""
    torque: Array
    """N m at the drum (n, cables), the drives' own figure"""
    tension: Array
    """N (n, cables), tared"""
    desired: Array
    """m (n, 3)"""
    stiffness: Array
    """N/m (n,), commanded"""
    good: Mask
    """(n,): every drive and every cell answered in time"""
    ticks: NDArray[np.int64]
    """(k,) of the log's own rows; some may be missing"""
    exposure: Array
    """s (m,) when the tracker saw the platform"""
    seen_position: Array
    """m (m, 3)"""
    seen_rotation: Rotation
    """(m,)"""

    def on_grid(self, values: Array) -> Array:
        """Values (k, c) of the log's own rows, as rows (n, c)."""
        return _filled(self.ticks, values)

    def smooth(self, values: Array) -> Array:
        """Values (n, ...) low-passed without phase."""
        b, a = butter(2, _SMOOTHING_HZ, fs=1.0 / self.period)
        return np.asarray(filtfilt(b, a, values, axis=0))

    def inner(self, chosen: Mask) -> Mask:
        """Rows (n,) whose neighbours, as far as `smooth` reaches, are chosen as well."""
        width = 2 * round(_EDGE_S / self.period) + 1
        return np.asarray(binary_erosion(chosen, np.ones(width, dtype=bool)))

    def during(self, *states: State) -> Mask:
        """Rows (n,) in one of the states, all devices heard and every cable taut."""
        taut = self.smooth(self.tension).min(axis=1) > self.config.control.tension.slack
        return np.asarray(np.isin(self.state, states) & self.good & taut)

    @cached_property
    def blocks(self) -> NDArray[np.int64]:
        """(n,)"""
        return np.asarray((self.time - self.time[0]) / BLOCK_S, dtype=np.int64)

    @cached_property
    def position(self) -> Array:
        """m (n, 3): the tracker's, between its exposures by cubics."""
        return self._between(self.seen_position)

    @cached_property
    def rotation(self) -> Rotation:
        """(n,): the tracker's, smoothed since the platform is kept level."""
        middle = self.seen_rotation.mean()
        turns = self._between((middle.inv() * self.seen_rotation).as_rotvec())
        return middle * Rotation.from_rotvec(self.smooth(turns))

    def _between(self, seen: Array) -> Array:
        within = np.clip(self.time, self.exposure[0], self.exposure[-1])
        return np.asarray(CubicSpline(self.exposure, seen)(within))

    @cached_property
    def direction(self) -> Array:
        """Unit vectors (n, cables, 3) along which the cables pull the platform, base frame."""
        way = ways(self.config, self.position, self.rotation)
        return np.asarray(way / np.linalg.norm(way, axis=2, keepdims=True))

    @cached_property
    def force(self) -> Array:
        """N (n, 3): the cables' on the platform, Σ T u, base frame."""
        return np.asarray(np.einsum("nci,nc->ni", self.direction, self.tension))

    @cached_property
    def tare_error(self) -> Array:
        """N (cables,): standard error of the cells' zero, from their noise while tared."""
        raw = self.log["/tonus/force_cells"]["raw"][:, :-1]
        before = raw[self.log["/tonus/state"]["state"] == State.OFF]
        if len(before) < 2:
            return np.zeros(raw.shape[1])
        return np.asarray(before.std(axis=0, ddof=1) / np.sqrt(len(before)))


def _filled(ticks: NDArray[np.int64], values: Array) -> Array:
    """Ticks that were missed lie on the line between their neighbours."""
    grid = np.arange(ticks[0], ticks[-1] + 1)
    return np.stack([np.interp(grid, ticks, column) for column in values.T], axis=1)


def ways(config: Config, position: Array, rotation: Rotation) -> Array:
    """From platform to frame anchors (n, cables, 3), m, at poses (n,)."""
    geometry = config.robot.geometry
    frame, tips = np.array(geometry.frame), np.array(geometry.platform)
    turned = np.einsum("nij,cj->nci", rotation.as_matrix(), tips)
    return np.asarray(frame - (position[:, None, :] + turned))


def read(path: Path) -> Record:
    """Read a log. Raises ToolError when it is damaged or something that is needed is not in it."""
    log = open_log(path)
    missing = [name for name in _TOPICS if f"/tonus/{name}" not in log]
    if missing:
        raise ToolError(f"{path}: there is no topic /tonus/{missing[0]}; name a log of `tonus run`")
    log.load([f"/tonus/{name}" for name in _TOPICS])
    if log.damage:
        raise ToolError(f"{path}: damaged: {log.damage}; identify from a whole log")
    config = _config(log)
    timing, tracker = log["/tonus/timing"], log["/tonus/tracker"]
    period = config.control.rates.period
    ticks = timing["tick"].astype(np.int64)
    fresh = tracker["fresh"] == 1
    if np.count_nonzero(fresh) < _FEWEST_POSES:
        raise ToolError(
            f"{path}: {np.count_nonzero(fresh)} tracker poses, {_FEWEST_POSES} are needed; "
            "record with the tracker on"
        )
    exposure = ticks[fresh] * period - tracker["delay"][fresh]
    # A spline wants time to run forward, and jitter may let two exposures change places.
    exposure, order = np.unique(exposure, return_index=True)
    drives, cells = log["/tonus/drives"], log["/tonus/force_cells"]
    grid = np.arange(ticks[0], ticks[-1] + 1)
    row = np.searchsorted(ticks, grid)

    heard = (drives["age"].max(axis=1) == 0) & (cells["age"].max(axis=1) == 0)
    return Record(
        path=path,
        log=log,
        config=config,
        period=period,
        # What a tick reads was sampled at the SYNC of the tick before (docs/control.md).
        time=(grid - 1) * period,
        state=log["/tonus/state"]["state"][row],
        angle=_filled(ticks, drives["angle"]),
        torque=_filled(ticks, drives["torque"]),
        tension=_filled(ticks, log["/tonus/tension"]["measured"]),
        desired=_filled(ticks, log["/tonus/pose"]["desired_position"]),
        stiffness=log["/tonus/stiffness"]["k_eq"][row],
        good=heard[row] & (ticks[row] == grid),
        ticks=ticks,
        exposure=exposure,
        seen_position=tracker["position"][fresh][order],
        seen_rotation=Rotation.from_quat(
            np.roll(tracker["quaternion"][fresh][order], -1, axis=1)  # x y z w
        ),
    )


def _config(log: Log) -> Config:
    text = log.config_text
    if text is None:
        raise ToolError(f"{log.path}: it carries no configuration; name a log of `tonus run`")
    try:
        return Config.model_validate(yaml.safe_load(text))
    except (yaml.YAMLError, ValidationError) as error:
        line = str(error).splitlines()[0]
        raise ToolError(
            f"{log.path}: its configuration is not this version's ({line}); "
            "identify with the version that recorded it"
        ) from error
