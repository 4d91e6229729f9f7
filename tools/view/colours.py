"""Colours of the picture and its legend, told apart by the colour-blind (Okabe and Ito)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.tools.view.moment import Array

Levels = tuple[float, float, float, float]
"""N: slack, low, pretension and high, where the colours stand"""

SLACK = (20, 20, 20)
LOW, PRE, HIGH = (0, 114, 178), (140, 140, 140), (213, 94, 0)
GHOST = (120, 150, 190)
_SCALE = np.array([LOW, PRE, HIGH], float)


@dataclass(frozen=True)
class Tint:
    """Of a second run in the same picture."""

    colour: tuple[int, int, int]

    def over(self, colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Colours (n, 3) half mixed with the tint."""
        mixed: NDArray[np.uint8] = ((colours + np.array(self.colour)) / 2).astype(np.uint8)
        return mixed


TINTS = (Tint((230, 159, 0)), Tint((0, 158, 115)), Tint((204, 121, 167)))


def of_tension(tension: Array, levels: Levels) -> NDArray[np.uint8]:
    """RGB (n, 3) of tensions (n,) in N; black where a cable is slack."""
    slack, *stops = levels
    mixed = np.stack([np.interp(tension, stops, each) for each in _SCALE.T], axis=-1)
    return np.where(tension[:, None] < slack, SLACK, mixed).astype(np.uint8)
