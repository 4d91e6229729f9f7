"""The fixture ``tonus_held``: runs that begin with the robot brought up."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from tonus.config import Config, Scenario
from tonus.config.schema.faults import Fault
from tonus.runtime.states import Operator
from tonus.runtime.timing import clock
from tonus.tools.errors import ToolError
from tonus.tools.expect import Run
from tonus.tools.log import open as open_log
from tonus.tools.run.held import HeldRobot, HeldRun, Holding, undisturbed
from tonus.tools.run.held_talk import Said
from tonus.tools.run.order import Result
from tonus.tools.testing.arguments import number
from tonus.tools.testing.case import Case
from tonus.tools.testing.lab import made
from tonus.tools.testing.player import Faults, settled_scenario

_ROBOTS: OrderedDict[tuple[str, str, int, str], HeldRobot] = OrderedDict()
"""those of this process, the latest used last"""
_MOST = 3
"""robots held at once; each is a process with some 250 MB"""
_COMMANDS = {each.name.lower(): each for each in Operator if each is not Operator.NONE}


class HeldFactory:
    """The fixture itself. A robot is brought up for the first test that asks for it, and serves
    every later one of the process with the same configuration, scenario and seed."""

    def __init__(self, case: Case) -> None:
        self._case = case

    def __call__(
        self,
        scenario: str | Path | Scenario = "hold",
        *,
        at: Holding = "HOLD",
        config: str | Path | Config | None = None,
        overrides: dict[str, Any] | None = None,
        seed: int | None = None,
    ) -> Held:
        """A run that the test advances itself, from HOLD or ACTIVE on. It ends with the test.
        Raises `ConfigError`, and `ToolError` for a robot that does not come up."""
        __tracebackhide__ = True
        case = self._case
        if at not in get_args(Holding):
            raise ToolError(f"at: {at!r} is not possible; HOLD or ACTIVE are")
        settings, played, chosen = self._settled(scenario, (), None, config, overrides, seed)
        began = clock.wall_seconds()
        robot = _robot(settings, played, chosen, at)
        ready = clock.wall_seconds()
        case.bring_up_s += ready - began
        run = case.closing.enter_context(robot.operated(case.folder()))
        held = Held(case, run, ready)
        case.open.append(held.end)
        return held

    def play(
        self,
        scenario: str | Path | Scenario = "hold",
        *,
        config: str | Path | Config | None = None,
        faults: Faults = (),
        seed: int | None = None,
        overrides: dict[str, Any] | None = None,
        duration: float | None = None,
    ) -> Run:
        """What ``tonus_run`` gives for the same arguments, from HOLD on, bit for bit. Faults that
        are due before HOLD are refused. Raises `ConfigError` and `ToolError`."""
        __tracebackhide__ = True
        settings, played, chosen = self._settled(
            scenario, faults, duration, config, overrides, seed
        )
        began = clock.wall_seconds()
        result = _robot(settings, played, chosen, "HOLD").play(self._case.folder(), played)
        return _ran(self._case, result, clock.wall_seconds() - began, ())

    def _settled(
        self,
        scenario: str | Path | Scenario,
        faults: Faults,
        duration: float | None,
        config: str | Path | Config | None,
        overrides: dict[str, Any] | None,
        seed: int | None,
    ) -> tuple[Config, Scenario, int]:
        case = self._case
        settings = case.configuration(config, overrides)
        played = settled_scenario(case, scenario, faults, duration)
        return settings, played, case.seeded(seed)


class Held:
    """One run. Nothing happens but in `advance`."""

    def __init__(self, case: Case, run: HeldRun, began: float) -> None:
        """``began``: s of wall time, before the run was forked."""
        self._case, self._run, self._began = case, run, began
        self._events = list(run.seen.events)
        self._injected: list[tuple[int, Fault]] = []
        self._made: Run | None = None

    @property
    def state(self) -> str:
        """By name."""
        return self._run.seen.state.name

    @property
    def reason(self) -> str:
        """Name of the fault that the robot stopped for, NONE without one (docs/states.md)."""
        return self._run.seen.fault

    @property
    def now(self) -> float:
        """s since the run began."""
        return self._run.seen.time

    @property
    def record(self) -> NDArray[np.void]:
        """The last tick's signals: a record () with a field for each topic of docs/log.md, such as
        ``record["tension"]["measured"]`` (n,) in N."""
        found: NDArray[np.void] = self._run.seen.record.reshape(())
        return found

    @property
    def truth(self) -> NDArray[np.void]:
        """The plant's true state: a record () with the fields of ``/tonus/truth``."""
        found: NDArray[np.void] = self._run.seen.truth.reshape(())
        return found

    @property
    def events(self) -> list[Said]:
        """Those so far, with their time in s since the run began."""
        return self._events

    def advance(self, ms: float) -> None:
        """Let so many ms of robot time pass, in whole ticks."""
        __tracebackhide__ = True
        self._run.advance(number("advance", ms) * 1e-3)
        self._events += self._run.seen.events

    def fault(self, fault: Fault | str, **fields: Any) -> None:
        """Inject a fault: one of `tonus.faults`, or its kind with its fields (docs/faults.md).
        ``at``: s from now. Raises `ToolError` for one that is not possible."""
        __tracebackhide__ = True
        one = made(fault, fields)
        self._run.inject(one)
        self._injected.append((round(self.now * 1e9), one))

    def command(self, name: str) -> None:
        """Tell the next tick: start, hold, stop, estop or reset. Raises `ToolError`."""
        __tracebackhide__ = True
        if name not in _COMMANDS:
            raise ToolError(f"command {name}: choose one of {', '.join(_COMMANDS)}")
        self._run.command(_COMMANDS[name])

    def finish(self) -> Run:
        """A controlled stop, to STANDBY or FAULT; gives the whole run."""
        __tracebackhide__ = True
        return self._over(self._run.finish(), cut=False)

    def end(self) -> Run:
        """Stop here, the robot left as it is; gives the run so far."""
        __tracebackhide__ = True
        return self._over(self._run.end(), cut=True)

    def _over(self, result: Result, *, cut: bool) -> Run:
        if self._made is None:
            spent = clock.wall_seconds() - self._began
            self._made = _ran(self._case, result, spent, self._injected, cut=cut)
        return self._made


def _robot(config: Config, scenario: Scenario, seed: int, at: Holding) -> HeldRobot:
    """One that is held already, or brought up now."""
    base = undisturbed(scenario).model_copy(update={"duration": 1.0})
    key = (config.model_dump_json(), base.model_dump_json(), seed, at)
    if key in _ROBOTS and _ROBOTS[key].alive:
        _ROBOTS.move_to_end(key)
        return _ROBOTS[key]
    while len(_ROBOTS) >= _MOST:
        _, oldest = _ROBOTS.popitem(last=False)
        oldest.close()
    robot = _ROBOTS[key] = HeldRobot(config, scenario, seed=seed, at=at)
    return robot


def _ran(
    case: Case,
    result: Result,
    total_s: float,
    injected: list[tuple[int, Fault]] | tuple[()],
    *,
    cut: bool = False,
) -> Run:
    log = open_log(result.log)
    first_ns = int(log.times("/tonus/timing")[0])
    struck = [(first_ns + after_ns, fault) for after_ns, fault in injected]
    return case.ran(
        Run(log, reason=result.outcome.reason, cut=cut, injected=struck), total_s, result.seconds
    )
