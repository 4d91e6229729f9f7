"""Mistakes of a test's author, told in one line: pytest shows no code of Tonus for them."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import can

from tonus.config.errors import ConfigError
from tonus.runtime.errors import ControllerError
from tonus.sim.errors import LabError
from tonus.tools.errors import ToolError

MISTAKES = (ConfigError, ControllerError, LabError, ToolError, can.CanInitializationError)
"""What a fixture raises for input that the author can correct."""


def shorten(caught: Any) -> bool:
    """Take the frames of Tonus and the causes out of a `pytest.ExceptionInfo`. Whether a frame of
    the author's remains: of an error in a fixture none does."""
    caught.value.__cause__, caught.value.__suppress_context__ = None, True
    frames: list[TracebackType] = []
    frame: TracebackType | None = caught.tb
    while frame is not None:
        if not frames or _package(frame) != "tonus":
            frames.append(frame)
        frame = frame.tb_next
    # pytest follows these links again when it prints, so that they have to be shortened themselves.
    for one, following in zip(frames, [*frames[1:], None], strict=True):
        one.tb_next = following
    caught.traceback = type(caught.traceback)(caught.tb)
    return any(_package(each) not in ("_pytest", "pluggy", "tonus") for each in frames)


def _package(frame: TracebackType) -> str:
    return str(frame.tb_frame.f_globals.get("__name__", "")).partition(".")[0]
