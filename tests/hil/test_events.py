"""What a person reads later: degraded modes are named when they begin and when they end."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

from hil.runs import configured

from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.operator import Script
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.devices.tracker import DATAGRAM
from tonus.sim.lab.engine import Lab

Times = tuple[tuple[float, float], ...]
"""s from and to, in ACTIVE"""


@dataclass
class Heard:
    """Events and records kept in memory, as a ring and an event sink."""

    events: list[tuple[int, str]] = field(default_factory=list)
    cycles: int = 0

    def __call__(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        assert text
        self.events.append((tick, name))

    def publish(self, payload: object, stamp_ns: int) -> None:
        self.cycles += 1

    @property
    def names(self) -> list[str]:
        return [name for _, name in self.events]


class Camera:
    """The lab's tracker on a tripod that somebody may knock against: poses are then ``shift`` m off
    along x."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self.shift = 0.0

    def poll(self, now_ns: int) -> list[bytes]:
        return [self._seen(datagram) for datagram in self._lab.tracker.poll(now_ns)]

    def close(self) -> None:
        """Nothing is open."""

    def _seen(self, datagram: bytes) -> bytes:
        parts = list(DATAGRAM.unpack(datagram))
        parts[6] += self.shift
        return DATAGRAM.pack(*parts)


class Meddler(Script):
    """A script that hides the platform from the tracker at times in ACTIVE, or knocks against its
    camera after 0.3 s."""

    def __init__(
        self, duration: float, lab: Lab, camera: Camera, hidden: Times, knock: float
    ) -> None:
        super().__init__(duration)
        self._lab, self._camera, self._hidden, self._knock = lab, camera, hidden, knock

    def next(self, sequence: Sequence) -> Operator:
        if sequence.state is State.ACTIVE:
            at = sequence.elapsed
            self._lab.tracker.blocked = any(first <= at < last for first, last in self._hidden)
            if sequence.elapsed >= 0.3:
                self._camera.shift = self._knock
        return super().next(sequence)


@cache
def play(hidden: Times = (), knock: float = 0.0) -> tuple[Outcome, Heard]:
    config, scenario = configured("config/direct.yaml", duration=1.2)
    heard = Heard()

    async def main() -> Outcome:
        now = clock.loop_clock()
        lab = Lab(config, scenario.lab, seed=1, clock=now)
        image, camera = ProcessImage(8), Camera(lab)
        daemon = Daemon(
            config,
            scenario,
            DirectFieldbus(config, image, lab.direct, now),
            TrackerInput(image, camera),
            Meddler(scenario.duration, lab, camera, hidden, knock),
            ring=heard,
            events=heard,
            stopwatch=clock.Stopwatch(running=False),
        )
        return await daemon.run(VirtualPacing, lambda _: None, lambda: None)

    return clock.run(main(), virtual=True), heard


def test_a_hidden_tracker_is_a_named_mode_and_no_fault() -> None:
    """And a short gap before it is nothing to speak of."""
    outcome, heard = play(hidden=((0.1, 0.14), (0.3, 0.8)))
    assert outcome.state is State.STANDBY
    assert heard.cycles == outcome.ticks
    assert heard.names.count("tracker_lost") == 1
    assert heard.names.count("tracker_back") == 1
    lost, back = (
        next(tick for tick, name in heard.events if name == wanted)
        for wanted in ("tracker_lost", "tracker_back")
    )
    assert 380 <= back - lost <= 430


def test_a_tracker_that_insists_is_followed_and_that_is_said() -> None:
    """A camera 2 mm aside cannot be told from cables that are; a pose every 8.3 ms, 24 of them."""
    outcome, heard = play(knock=0.002)
    assert outcome.state is State.STANDBY
    assert heard.names.count("tracker_learnt") == 1
    assert "tracker_lost" in heard.names
    assert "tracker_back" in heard.names


def test_a_tracker_too_far_off_is_not_followed_and_that_is_said() -> None:
    outcome, heard = play(knock=0.03)
    assert outcome.state is State.STANDBY
    assert heard.names.count("pose_tracker") == 1
    assert "tracker_learnt" not in heard.names


def test_sound_measurements_are_nothing_to_speak_of() -> None:
    _, heard = play()
    assert not [name for name in heard.names if name.startswith(("pose_", "tracker_"))]


def test_every_state_is_told_once_and_in_order() -> None:
    _, heard = play()
    assert heard.names.count("state") == 7
    assert heard.names.count("operator") == 3
