"""The rings of one run, each a file: what daemon and lab write, and a recorder reads."""

from __future__ import annotations

from pathlib import Path

from tonus.config.schema.root import Config
from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.recording.taps import EventRing, FrameRing, KeyframeRing
from tonus.runtime.signals import cycle_dtype, topics
from tonus.runtime.topics import to_json
from tonus.tools.run import fieldbuses
from tonus.tools.run.truth import TruthRing

FRAMES_PER_TICK = 64


class Rings:
    """Made in ``folder``, each for `recording.ring_s`; ``touched`` as in `RingWriter.create`."""

    def __init__(self, folder: Path, config: Config, *, touched: bool) -> None:
        cables = config.robot.cables
        self._folder, self._cables, self._touched = folder, cables, touched
        self.ticks = int(config.recording.ring_s / config.control.rates.period)
        """records that the ring of cycles holds"""
        meta = {"kind": "record", "topics": to_json(topics(cables))}
        size = cycle_dtype(cables).itemsize
        self.cycles = RingWriter.create(
            folder / "cycle.ring", size, self.ticks, meta, touched=touched
        )
        self.events = EventRing.open(folder / "events.ring", touched=touched)
        self.keyframes = KeyframeRing.open(folder / "keyframes.ring", touched=touched)
        self.frames: FrameRing | None = None
        """None where no frames are recorded, or there are none"""
        channels = fieldbuses.channels(config)
        if config.recording.raw_frames and channels:
            capacity = self.ticks * FRAMES_PER_TICK
            path = folder / "frames.ring"
            self.frames = FrameRing.open(path, channels, capacity, touched=touched)

    def truth(self) -> TruthRing:
        """A ring for the truth of a lab in this process."""
        path = self._folder / "truth.ring"
        return TruthRing(path, self.ticks, self._cables, touched=self._touched)
