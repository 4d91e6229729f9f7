"""A fieldbus of several: whatever becomes of one, the others are stopped."""

from __future__ import annotations

import asyncio

import pytest

from tonus.config import Config, load
from tonus.config.schema.bus import EthercatBus
from tonus.drivers.errors import BringUpError, DriverError
from tonus.drivers.fieldbus import Progress
from tonus.drivers.process_image import ProcessImage
from tonus.drivers.several import SeveralFieldbuses


class Part:
    """A fieldbus that only starts and stops, or fails to."""

    def __init__(self, kind: str, image: ProcessImage, failing: dict[str, str]) -> None:
        self.kind, self.image, self.channels = kind, image, (kind,)
        self.stopped = False
        self._failing = failing

    async def start(self, progress: Progress) -> None:
        if "start" in self._failing.get(self.kind, ""):
            raise BringUpError(f"{self.kind} did not start")

    def collect(self, tick: int) -> None:
        """Nothing comes in."""

    async def stop(self) -> None:
        await asyncio.sleep(0)
        self.stopped = True
        if "stop" in self._failing.get(self.kind, ""):
            raise DriverError(f"{self.kind} did not stop")


def several(failing: dict[str, str]) -> tuple[SeveralFieldbuses, list[Part]]:
    parts: list[Part] = []

    def build(config: Config, image: ProcessImage) -> Part:
        kind = "ethercat" if isinstance(config.fieldbus, EthercatBus) else "canopen"
        parts.append(Part(kind, image, failing))
        return parts[-1]

    config, _ = load("config/mixed.yaml")
    made = SeveralFieldbuses(config, ProcessImage(8), build)  # type: ignore[arg-type]
    return made, parts


@pytest.mark.parametrize("failing", ["canopen", "ethercat"])
def test_an_error_of_one_bus_leaves_none_running(failing: str) -> None:
    fieldbus, parts = several({failing: "stop"})
    with pytest.raises(DriverError, match=f"{failing} did not stop"):
        asyncio.run(fieldbus.stop())
    assert [(part.kind, part.stopped) for part in parts] == [("canopen", True), ("ethercat", True)]


def test_of_two_errors_the_first_is_raised() -> None:
    fieldbus, parts = several({"canopen": "stop", "ethercat": "stop"})
    with pytest.raises(DriverError, match="canopen did not stop"):
        asyncio.run(fieldbus.stop())
    assert all(part.stopped for part in parts)


def test_what_stopping_says_does_not_hide_why_the_start_failed() -> None:
    fieldbus, parts = several({"canopen": "stop", "ethercat": "start stop"})
    with pytest.raises(BringUpError, match="ethercat did not start"):
        asyncio.run(fieldbus.start(lambda _: None))
    assert all(part.stopped for part in parts)


@pytest.mark.parametrize("place", [0, 1])
def test_one_bus_on_which_the_supervisor_is_ignored_is_enough(place: int) -> None:
    fieldbus, parts = several({})
    for ignored in (True, False):
        parts[place].image.supervisor_ignored = ignored
        fieldbus.collect(0)
        assert fieldbus.image.supervisor_ignored is ignored
