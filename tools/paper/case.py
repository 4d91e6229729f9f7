"""What is to be done: one test of the protocol, and one trial of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from tonus.config.schema.scenario import Scenario


class Kind(StrEnum):
    """What a test asks, and so which indicators exist for it."""

    SLOPE = "slope"
    """stage 1: the platform displaced at constant tension, force against way"""
    SINE = "sine"
    MOVE = "move"
    """a minimum-jerk step of the reference"""
    RAMP = "ramp"
    """an external load that rises steadily and stays"""
    STEP = "step"
    """an external load that is there at once"""
    CONTACT = "contact"
    """the way is blocked by the phantom, unexpectedly"""
    PRESS = "press"
    """a force on the phantom, asked for"""
    HOLD = "hold"


@dataclass(frozen=True)
class Case:
    """One test of the protocol."""

    stage: int
    """1, 2 or 3; 0 for the drawn plants, which are a test of their own"""
    name: str
    """file-name safe: "sine_z_30mm_1Hz", "ramp_x", "contact" """
    kind: Kind
    scenario: Scenario
    overrides: tuple[tuple[str, Any], ...] = ()
    """dotted keys of the configuration that this test alone changes, with their values"""


@dataclass(frozen=True)
class Run:
    """One trial to do."""

    case: Case
    controller: str
    plant: str
    """"model", "lab" or a drawn one, "plant-017" """
    seed: int
    bus: str
    """"direct" or "can" """

    @property
    def key(self) -> str:
        """Unique in a campaign and safe as a file's name."""
        return f"{self.case.name}.{self.controller}.{self.plant}.{self.bus}.seed{self.seed}"
