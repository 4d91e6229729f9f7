"""What docs/commissioning.md tells people to do on a bus and in a drive can be done in the lab."""

from __future__ import annotations

import re

import pytest
from one_drive import OneDrive

from tonus.config.loader import HERE

PAGE = (HERE.parent / "docs/commissioning.md").read_text(encoding="utf-8")


def step(number: int) -> str:
    return PAGE.partition(f"\n## {number}. ")[2].partition("\n## ")[0]


@pytest.mark.parametrize("bit", [0, 1])
def test_the_polarity_of_step_7_is_one_that_a_drive_has(bit: int) -> None:
    """A drive whose direction is wrong is turned round there; another subindex is read only."""
    ((index, sub),) = re.findall(r"set the axis polarity \(0x([0-9A-F]{4}):(\d+), bit 0\)", step(7))
    drive = OneDrive()
    drive.write(int(index, 16), int(sub), bit)
    assert drive.read(int(index, 16), int(sub)) == bit
