"""One run in virtual time, kept in memory: from OFF, or forked from one that is under way."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Protocol

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.operator import Script
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.observed import FAULTED, GOOD, End, Observed
from tonus.tools.campaign.strikes import strikes
from tonus.tools.log.log import Event
from tonus.tools.run import fieldbuses
from tonus.tools.run.kept import Kept
from tonus.tools.run.supervision import supervised, wanted
from tonus.tools.run.turning import TurningPacing


class Operated(Script):
    """A scenario's script that goes on for a while after its end, so that it can be seen what
    becomes of a robot that is switched off, and that does not wait for an end for ever."""

    def __init__(
        self, scenario: Scenario, period: float, tail: float, longest: float, patience_s: float
    ) -> None:
        super().__init__(scenario.duration, patience_s, scenario.operator, period)
        self._left, self._longest = round(tail / period), round(longest / period)

    @property
    def finished(self) -> bool:
        return (super().finished and self._left <= 0) or self.armed_for > self._longest

    def next(self, sequence: Sequence) -> Operator:
        if super().finished:
            self._left -= 1
            return Operator.NONE
        return super().next(sequence)


class Turn(Protocol):
    """Asked before each tick of a run that others may be forked from."""

    def __call__(self, playing: Playing) -> None: ...


class Playing:
    """A run: its parts, and what they have recorded so far."""

    def __init__(
        self,
        config: Config,
        scenario: Scenario,
        seed: int,
        *,
        tail: float,
        longest: float,
        turn: Turn | None = None,
    ) -> None:
        """``tail`` and ``longest``: s, as in `tonus.config.schema.campaign.Times`. ``turn`` may
        fork the process and `take_up` an episode in the child."""
        self.config, self.scenario, self._seed = config, scenario, seed
        # The supervisor begins after a while, and a relay of the STO inputs closes after that.
        patience_s = config.operation.self_test.patience_s if wanted(config) else 0.0
        period = config.control.rates.period
        self.script = Operated(scenario, period, tail, longest, patience_s)
        self._turn = turn
        cables = config.robot.cables
        self._cycles, self._truths = Kept(cycle_dtype(cables)), Kept(truth_dtype(cables))
        self._events: list[Event] = []
        self.lab: Lab | None = None

    def take_up(self, scenario: Scenario) -> None:
        """Go on with the faults and commands of a scenario that has been the same until now."""
        assert self.lab is not None
        self.scenario = scenario
        self.lab.extend_script(scenario.lab.faults)
        self.script.follow(scenario.operator)

    def run(self, named: frozenset[str] = frozenset()) -> Observed:
        """To the end. An exception of the program is part of what was seen. ``named``: kinds of
        faults that an event has to name."""
        outcome: Outcome | None = None
        error = ""
        try:
            outcome = clock.run(self._main(), virtual=True)
        except Exception as caught:  # noqa: BLE001 - whatever it is, it is a finding
            error = describe(caught)
        begun = self.lab.script_start_ns if self.lab is not None else None
        faults = self.scenario.lab.faults if begun is not None else ()
        truth_stamps = self._truths.stamps
        last = int(truth_stamps[-1]) if len(truth_stamps) else 0
        found = strikes(self.config, faults, begun or 0, named)
        return Observed(
            self.config,
            self.scenario,
            self._cycles.rows,
            self._cycles.stamps,
            self._truths.rows,
            truth_stamps,
            self._events,
            [strike for strike in found if strike.at_ns <= last],
            _end(outcome) if outcome is not None else None,
            error,
        )

    async def _main(self) -> Outcome:
        config = self.config
        image = ProcessImage(config.robot.cables)
        lab = self.lab = Lab(
            config,
            self.scenario.lab,
            seed=self._seed,
            clock=clock.loop_clock(),
            truth=self._truths.publish,
        )
        lab.open()
        try:
            fieldbus = fieldbuses.build(config, image, lab)
            with supervised(config, self._cycles) as ring:
                daemon = Daemon(
                    config,
                    self.scenario,
                    fieldbus,
                    TrackerInput(image, lab.tracker),
                    self.script,
                    ring=ring,
                    events=self._event,
                    stopwatch=clock.Stopwatch(running=False),
                )
                pacing = fieldbuses.steering(
                    config, fieldbus, lambda: TurningPacing(self._before_tick)
                )
                return await daemon.run(pacing, lambda _: None, lambda: None)
        finally:
            lab.close()

    def _before_tick(self) -> None:
        if self._turn is not None:
            self._turn(self)

    def _event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self._events.append(Event(stamp_ns, tick, int(level), name, where, text))


def play(
    episode: Episode, *, tail: float, longest: float, named: frozenset[str] = frozenset()
) -> Observed:
    """An episode from OFF, in this process. Raises `ConfigError` and `LabError` for one that does
    not fit its configuration."""
    setup = episode.setup
    playing = Playing(setup.settle(), episode.scenario, setup.seed, tail=tail, longest=longest)
    return playing.run(named)


def _end(outcome: Outcome) -> End:
    good = outcome.fault is Fault.NONE and not outcome.obstacle and not outcome.overrun
    state = State(outcome.state)
    return End(state, outcome.fault, outcome.reason, GOOD if good else FAULTED)


def describe(error: BaseException) -> str:
    """Type, words and place of an exception, in one line."""
    frames = traceback.extract_tb(error.__traceback__)
    at = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{at}"
