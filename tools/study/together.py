"""Runs of a study of which no log is kept stay in memory, and those that differ in their scenario
alone have one bring-up.

Each goes on from HOLD in a process of its own (`tonus.tools.run.parting`), and its row is that of
a run from OFF, bit for bit.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tonus.config.errors import ConfigError
from tonus.config.schema.lab import LabScript
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.ports import LEFT_OUT, Recorded
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import TABLE, cycle_dtype
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.campaign.station import cause, watch
from tonus.tools.expect.names import full
from tonus.tools.forking import die_with_parent
from tonus.tools.log.log import Event
from tonus.tools.repeat import every
from tonus.tools.run import fieldbuses
from tonus.tools.run.composer import DRAIN_S
from tonus.tools.run.kept import Kept
from tonus.tools.run.kept_log import KeptLog
from tonus.tools.run.parting import Parting, Selecting, until_active
from tonus.tools.run.release import releasing
from tonus.tools.run.run_folder import LOG
from tonus.tools.run.summary import TRUTH
from tonus.tools.run.supervision import supervised, wanted
from tonus.tools.run.turning import TurningPacing
from tonus.tools.study.play import SECONDS, Row, caught, failed, play, row_of
from tonus.tools.study.provenance import loaded
from tonus.tools.study.trials import Trial

_CLEAR = 0.005
"""m by which the way home has to pass a phantom that comes later"""
_KEPT = frozenset({*(topic.name for topic in TABLE), TRUTH})
_FREE = {"name", "description", "duration", "reference"}
"""what of a scenario is of no effect before ACTIVE"""


@dataclass(frozen=True)
class _Settled:
    trial: Trial
    config: Config
    scenario: Scenario


def alike(study: ParameterStudy, todo: Sequence[Trial]) -> list[list[Trial]]:
    """Trials that may share a bring-up, in the order of their first ones."""
    if not _needs_no_log(study):
        return [[trial] for trial in todo]
    found: dict[str, list[Trial]] = {}
    for trial in todo:
        same = f"{trial.config} {trial.controller} {trial.seed} {trial.parameters}"
        found.setdefault(same, []).append(trial)
    return list(found.values())


def play_alone(study: ParameterStudy, trial: Trial, folder: Path) -> Row:
    """As `play`, without a file where the study keeps none."""
    if not _needs_no_log(study):
        return play(study, trial, folder)
    try:
        settled = _Settled(trial, *loaded(study, trial))
    except ConfigError as error:
        return failed(study, trial, str(error))
    rows: list[Row] = []
    _Together(study, [settled], folder.parent, rows.append).play()
    return rows[0]


def _needs_no_log(study: ParameterStudy) -> bool:
    """Whether the study keeps no logs, and measures only what a record has."""
    return study.keep == "figures" and all(full(m.topic) in _KEPT for m in study.measures.values())


def play_together(
    study: ParameterStudy, trials: Sequence[Trial], folder: Path, tell: Callable[[Row], None]
) -> None:
    """Play what `alike` has put together; ``tell`` is called once for each, in whichever process it
    was played. ``folder`` is of runs that are not alike after all. Does not return in a fork."""
    parts: dict[str, list[_Settled]] = {}
    for trial in trials:
        try:
            settled = _Settled(trial, *loaded(study, trial))
        except ConfigError as error:
            tell(failed(study, trial, str(error)))
            continue
        parts.setdefault(_beginning(settled), []).append(settled)
    for part in parts.values():
        sys.stdout.flush()
        sys.stderr.flush()
        process = os.fork()
        if process == 0:
            die_with_parent()
            watch(study.longest)
            _Together(study, part, folder, tell).play()
            os._exit(0)
        _, status = os.waitpid(process, 0)
        code = os.waitstatus_to_exitcode(status)
        if code:
            # Whoever has told its row already is told again, and counts once.
            for each in part:
                tell(failed(study, each.trial, cause(code, study.longest)))


def _beginning(settled: _Settled) -> str:
    """All that a run depends on before ACTIVE."""
    config, scenario = settled.config, settled.scenario
    script = until_active(scenario.lab, _CLEAR, config)
    same = scenario.model_copy(update={"lab": script})
    # To watch a load takes turns of the loop: on a bus the bring-up ends at another time for it.
    pulled = _pulls(scenario) and not all(bus.virtual_only for bus in config.fieldbus.parts)
    return f"{config.model_dump_json()}{same.model_dump_json(exclude=_FREE)}{pulled}"


def _pulls(scenario: Scenario) -> bool:
    return scenario.lab.load is not None or scenario.lab.displacement is not None


class _Together:
    def __init__(
        self,
        study: ParameterStudy,
        settled: Sequence[_Settled],
        folder: Path,
        tell: Callable[[Row], None],
    ) -> None:
        self._study, self._settled, self._folder, self._tell = study, settled, folder, tell
        self._config = config = settled[0].config
        scenarios = [each.scenario for each in settled]
        played, period = scenarios[0], config.control.rates.period
        patience_s = config.operation.self_test.patience_s if wanted(config) else 0.0
        self._script = Selecting(played.duration, patience_s, played.operator, period)
        self._shared: LabScript = played.lab
        if len(scenarios) > 1:
            self._shared = until_active(played.lab, _CLEAR, config)
        self._parting = Parting(scenarios, self._shared, self._script, self._lost, self._begin)
        cables = config.robot.cables
        self._cycles, self._truths = Kept(cycle_dtype(cables)), Kept(truth_dtype(cables))
        self._events: list[Event] = []
        self._began = clock.wall_seconds()

    def play(self) -> None:
        """Tells the row of each, here or in a fork."""
        reason = ""
        try:
            outcome = clock.run(self._main(), virtual=True)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is these runs'
            reason = caught(error)
        left = self._parting.left
        took = {SECONDS: round((clock.wall_seconds() - self._began) / len(left), 3)}
        for number in left:
            each = self._settled[number]
            if reason:
                row = failed(self._study, each.trial, reason)
            else:
                path = self._folder / f"{each.trial.index:06d}" / LOG
                log = KeptLog(path, self._cycles, self._truths, self._events)
                try:
                    row = row_of(self._study, each.trial, each.config, each.scenario, outcome, log)
                except Exception as error:  # noqa: BLE001 - of a measure: a row, not the end
                    row = failed(self._study, each.trial, caught(error))
            self._tell(row | took)

    async def _main(self) -> Outcome:
        config, first = self._config, self._settled[0]
        image = ProcessImage(config.robot.cables)
        lab = Lab(
            config,
            self._shared,
            seed=first.trial.seed,
            clock=clock.loop_clock(),
            truth=self._truths.publish,
        )
        lab.open()
        parting = self._parting
        # As in a run with a log: on a bus the bring-up ends where the loop's timers have it.
        idle = every(DRAIN_S, lambda: None)
        try:
            fieldbus = fieldbuses.build(config, image, lab)
            with supervised(config, self._cycles) as ring:
                daemon = Daemon(
                    config,
                    first.scenario,
                    fieldbus,
                    TrackerInput(image, lab.tracker),
                    self._script,
                    ring=ring,
                    events=self._event,
                    stopwatch=clock.Stopwatch(running=False),
                    others=[each.scenario for each in self._settled[1:]],
                    recorded=Recorded(lean=self._lean),
                )
                parting.of(daemon, lab, lambda: self._truths.rows["position"])
                if any(_pulls(each.scenario) for each in self._settled):
                    watching = releasing(self._played, daemon.cycle.sequence, lab.release_load)
                    daemon.serve("load of the lab", watching)
                pacing = fieldbuses.steering(
                    config, fieldbus, lambda: TurningPacing(parting.before_tick)
                )
                return await daemon.run(pacing, lambda _: None, lambda: None)
        finally:
            idle()
            lab.close()

    def _played(self) -> LabScript:
        left = self._parting.left
        return self._settled[left[0]].scenario.lab if len(left) == 1 else self._shared

    @property
    def _lean(self) -> bool:
        """Whether no figure is of what a lean record leaves out. A supervisor reads all of it."""
        measured = {f"{full(m.topic)}.{m.field}" for m in self._study.measures.values()}
        left_out = {f"/tonus/{name}" for name in LEFT_OUT}
        return left_out.isdisjoint(measured) and not wanted(self._config)

    def _begin(self) -> None:
        """By itself from here on: its time is its own."""
        watch(self._study.longest)
        self._began = clock.wall_seconds()

    def _lost(self, number: int, code: int) -> None:
        trial = self._settled[number].trial
        self._tell(failed(self._study, trial, cause(code, self._study.longest)))

    def _event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self._events.append(Event(stamp_ns, tick, int(level), name, where, text))
