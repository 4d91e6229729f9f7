"""Colours and lines of every picture: Okabe and Ito's palette, told apart with any common colour
vision, and viridis for what is continuous."""

from __future__ import annotations

from tonus.runtime.signals import Grade
from tonus.runtime.states import State

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
AXES = (BLUE, VERMILION, GREEN)
"""x, y, z"""
CABLES = (BLUE, VERMILION, GREEN, PURPLE)
CABLE_STYLES = ("-", "--")
"""upper, lower"""
RUNS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""in one picture"""
GRADES = {Grade.GREEN: GREEN, Grade.AMBER: ORANGE, Grade.RED: VERMILION}
BANDS = {
    State.OFF: "#FFFFFF",
    State.STANDBY: "#F4F4F4",
    State.REFERENCING: "#E6EEF6",
    State.PRETENSION: "#DCE6F0",
    State.HOLD: "#EAF4EC",
    State.ACTIVE: "#FFFFFF",
    State.SAFE_STOP: "#FBEBD9",
    State.FAULT: "#F7D9D4",
}
DASHES = (0, (6, 3))


def cable(number: int) -> tuple[str, str]:
    """Colour and line style of a cable, counted from 0."""
    return CABLES[number % len(CABLES)], CABLE_STYLES[number // len(CABLES) % len(CABLE_STYLES)]
