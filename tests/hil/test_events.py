"""What a person reads later: degraded modes are named when they begin and when they end."""

from __future__ import annotations

from dataclasses import dataclass, field

from hil.runs import configured

from drivers.direct import DirectFieldbus
from drivers.process_image import ProcessImage
from drivers.tracker import TrackerInput
from runtime import clock
from runtime.daemon import Daemon, Outcome
from runtime.operator import Script
from runtime.scheduler import VirtualPacing
from runtime.sequence import Sequence
from runtime.states import Operator, State
from runtime.taps import Level
from sim.lab import Lab


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


class Meddler(Script):
    """A script that hides the platform from the tracker for a while in ACTIVE."""

    def __init__(self, duration: float, lab: Lab, hidden: tuple[float, float]) -> None:
        super().__init__(duration)
        self._lab, self._hidden = lab, hidden

    def next(self, sequence: Sequence) -> Operator:
        if sequence.state is State.ACTIVE:
            first, last = self._hidden
            self._lab.tracker.blocked = first <= sequence.elapsed < last
        return super().next(sequence)


def play(hidden: tuple[float, float]) -> tuple[Outcome, Heard]:
    config, scenario = configured("config/direct.yaml", duration=1.2)
    heard = Heard()

    async def main() -> Outcome:
        now = clock.loop_clock()
        lab = Lab(config, scenario.lab, seed=1, clock=now)
        image = ProcessImage()
        daemon = Daemon(
            config,
            scenario,
            DirectFieldbus(config, image, lab.direct, now),
            TrackerInput(image, lab.tracker),
            Meddler(scenario.duration, lab, hidden),
            ring=heard,
            events=heard,
            stopwatch=clock.Stopwatch(running=False),
        )
        return await daemon.run(VirtualPacing, lambda _: None, lambda: None)

    return clock.run(main(), virtual=True), heard


def test_a_hidden_tracker_is_a_named_mode_and_no_fault() -> None:
    outcome, heard = play(hidden=(0.2, 0.7))
    assert outcome.state is State.STANDBY
    assert heard.names.count("tracker_lost") == 1
    assert heard.names.count("tracker_back") == 1
    lost, back = (
        next(tick for tick, name in heard.events if name == wanted)
        for wanted in ("tracker_lost", "tracker_back")
    )
    assert 380 <= back - lost <= 430


def test_a_short_gap_is_nothing_to_speak_of() -> None:
    outcome, heard = play(hidden=(0.2, 0.24))
    assert outcome.state is State.STANDBY
    assert "tracker_lost" not in heard.names
    assert heard.cycles == outcome.ticks


def test_every_state_is_told_once_and_in_order() -> None:
    _, heard = play(hidden=(9.0, 9.0))
    assert heard.names.count("state") == 7
    assert heard.names.count("operator") == 3
