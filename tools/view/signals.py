"""Which signals the plots show: a fixed set with its bounds, and any of the record by its name."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tonus.runtime.signals import topics
from tonus.runtime.states import State
from tonus.tools.run.truth import TOPIC as TRUTH
from tonus.tools.view.moment import Array, Samples

if TYPE_CHECKING:
    from tonus.config.schema.root import Config

_FOLLOWING = (State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP)
_NAME = re.compile(r"([a-z_]+)\.([a-z_]+)(?:\[(\d{1,3})\])?")


@dataclass(frozen=True)
class Series:
    """One line of a plot."""

    name: str
    take: Callable[[Samples], Array]


@dataclass(frozen=True)
class Plot:
    """Lines with one axis, and the bounds drawn into it."""

    title: str
    unit: str
    series: tuple[Series, ...]
    bounds: tuple[float, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For the page."""
        names = [each.name for each in self.series]
        return {"title": self.title, "unit": self.unit, "series": names, "bounds": self.bounds}


def plots_of(config: Config) -> tuple[Plot, ...]:
    """The plots of a robot."""
    tension, control = config.control.tension, config.control
    cables = config.robot.cables
    period_us = control.rates.period * 1e6
    return (
        Plot(
            "Tensions",
            "N",
            tuple(_line(f"{axis}", "tension", "measured", axis) for axis in range(cables)),
            (tension.min, tension.max),
        ),
        Plot(
            "Stiffness",
            "N/m",
            (
                _line("K_eq", "stiffness", "k_eq"),
                _line("limit from the envelope", "stiffness", "cap"),
            ),
            (control.stiffness.minimum, control.stiffness.maximum),
        ),
        Plot(
            "Contact force",
            "N",
            (_line("contact", "wrench", "contact"),),
            (control.envelope.contact_limit,),
        ),
        Plot(
            "Position error", "mm", (Series("estimate", _estimated), Series("truth", _true)), (0.0,)
        ),
        Plot(
            "Time of the tick",
            "us",
            (
                _line("wake-up", "timing", "wakeup_us"),
                Series("cycle", _cycle),
            ),
            (period_us,),
        ),
        Plot(
            "Bus exchange",
            "% of the period",
            (Series("bus", lambda samples: 100 / period_us * _field(samples, "timing", "bus_us")),),
            (100.0,),
        ),
    )


def names_of(config: Config) -> list[str]:
    """Every number of the record, as ``topic.field`` or ``topic.field[index]``."""
    cables = config.robot.cables
    found = []
    for topic in (*topics(cables), TRUTH.sized(cables)):
        short = topic.name.rsplit("/", 1)[1]
        for field in topic.fields:
            places = [f"[{index}]" for index in range(field.size)] if field.size else [""]
            found += [f"{short}.{field.name}{place}" for place in places]
    return found


def series_of(name: str) -> Series | None:
    """By such a name; None where it is none."""
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    topic, field, index = match[1], match[2], match[3]

    def take(samples: Samples) -> Array:
        source = samples.truth if topic == "truth" else samples.rows
        if source is None:
            return _nothing(samples)
        column = source[field] if topic == "truth" else source[topic][field]
        return np.asarray(column if index is None else column[:, int(index)], np.float64)

    return Series(name, take)


def _line(name: str, topic: str, field: str, index: int | None = None) -> Series:
    def take(samples: Samples) -> Array:
        column = _field(samples, topic, field)
        return column if index is None else column[:, index]

    return Series(name, take)


def _field(samples: Samples, topic: str, field: str) -> Array:
    return np.asarray(samples.rows[topic][field], np.float64)


def _nothing(samples: Samples) -> Array:
    return np.full(len(samples), np.nan)


def _estimated(samples: Samples) -> Array:
    return _away(samples, samples.rows["pose"]["position"])


def _true(samples: Samples) -> Array:
    return _nothing(samples) if samples.truth is None else _away(samples, samples.truth["position"])


def _away(samples: Samples, position: Array) -> Array:
    """mm from the reference, where the robot follows one."""
    away = np.linalg.norm(position - samples.rows["pose"]["desired_position"], axis=1)
    follows = np.isin(samples.rows["state"]["state"], _FOLLOWING)
    return np.where(follows, 1e3 * away, np.nan)


def _cycle(samples: Samples) -> Array:
    timing = samples.rows["timing"]
    parts = [timing[name] for name in ("collect_us", "compute_us", "publish_us")]
    return np.asarray(sum(part.astype(np.float64) for part in parts))
