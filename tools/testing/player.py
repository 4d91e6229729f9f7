"""Runs, labs and replays for one test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tonus.config import Config, Scenario
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Fault
from tonus.config.schema.lab import LabScript
from tonus.runtime.control.controllers import Controller
from tonus.runtime.timing import clock
from tonus.tools.errors import ToolError
from tonus.tools.expect import Run
from tonus.tools.log import open as open_log
from tonus.tools.run.composer import Order
from tonus.tools.run.composer import run as carry_out
from tonus.tools.testing.arguments import mapping, named, number, sequence
from tonus.tools.testing.case import Case
from tonus.tools.testing.lab import VirtualLab, made

Faults = Sequence[Fault | Mapping[str, Any]]
"""Each one of `tonus.faults`, or its fields with its ``kind``; ``at`` in s after every drive is
enabled."""


class Player:
    """The fixtures ``tonus_run`` and ``tonus_shared_run``."""

    def __init__(self, case: Case, expected: Sequence[str] | None = None) -> None:
        """``expected``: names of warnings and errors; a run with another one is refused at once.
        None: the test judges its runs at its end."""
        self._case, self._expected = case, expected

    def __call__(
        self,
        scenario: str | Path | Scenario,
        *,
        config: str | Path | Config | None = None,
        controller: str | type[Controller] | None = None,
        faults: Faults = (),
        seed: int | None = None,
        overrides: dict[str, Any] | None = None,
        duration: float | None = None,
    ) -> Run:
        """Play a scenario to its end, in virtual time.

        ``scenario`` and ``config`` are names of shipped ones or files, which are looked for beside
        the test and in the project's root folder. ``faults`` are added to those of the scenario.
        ``overrides`` maps dotted keys of the configuration to values, beside those of the mark.
        ``duration``: s in ACTIVE.

        Raises `ConfigError`, `ToolError` and `LabError`, and `ExpectationError` for what nobody
        expected of a shared run.
        """
        __tracebackhide__ = True
        case = self._case
        changes = {**mapping("overrides", overrides)}
        if controller is not None:
            changes["control.controller"] = _name(controller)
        settings = case.configuration(config, changes)
        played = settled_scenario(case, scenario, faults, duration)
        chosen = case.seeded(seed)
        began = clock.wall_seconds()
        order = Order(settings, played, case.folder(), chosen, True, lambda _: None, live=False)
        with case.active():
            result = carry_out(order)
        total = clock.wall_seconds() - began
        run = Run(open_log(result.log), reason=result.outcome.reason)
        case.ran(run, total, result.seconds)
        if self._expected is not None:
            run.allow(*self._expected)
            run.undisturbed()
        return run


class LabFactory:
    """The fixture ``tonus_lab_factory``."""

    def __init__(self, case: Case) -> None:
        self._case = case

    def __call__(
        self,
        *,
        config: str | Path | Config | None = None,
        overrides: dict[str, Any] | None = None,
        seed: int | None = None,
        script: LabScript | None = None,
    ) -> VirtualLab:
        """A lab that is closed after the test. ``script`` begins when all drives are enabled.
        Raises `ConfigError` and `LabError`."""
        __tracebackhide__ = True
        settings = self._case.configuration(config, overrides)
        chosen = self._case.seeded(seed)
        lab = VirtualLab(settings, script, seed=chosen)
        self._case.closing.callback(lab.close)
        self._case.labs.append(lab)
        return lab


class Replayer:
    """The fixture ``tonus_replay``."""

    def __init__(self, case: Case) -> None:
        self._case = case

    def __call__(self, log: str | Path) -> Run:
        """Open a log, looked for beside the test and in the project's root folder, and let its
        inputs give its outputs again, bit for bit.

        Ticks that no recorded state leads up to are left out. What the log reports is no failure
        of the test. Raises `ExpectationError`, and `ToolError` for what is no log.
        """
        __tracebackhide__ = True
        run = Run(open_log(self._case.place(log)))
        run.replays(gaps=True)
        return run


def settled_scenario(
    case: Case, name: str | Path | Scenario, faults: Faults, duration: float | None
) -> Scenario:
    """A scenario by its name or file, with more faults and another duration. Raises `ConfigError`
    and `ToolError`."""
    __tracebackhide__ = True
    named("scenario", name, Scenario)
    scenario = name if isinstance(name, Scenario) else load_scenario(case.place(name))
    added = tuple(map(_fault, sequence("faults", faults)))
    lab = scenario.lab.model_copy(update={"faults": (*scenario.lab.faults, *added)})
    changes: dict[str, Any] = {"lab": lab}
    if duration is not None:
        changes["duration"] = number("duration", duration, above_zero=True)
    return scenario.model_copy(update=changes)


def _fault(given: Fault | Mapping[str, Any]) -> Fault:
    if not isinstance(given, Mapping):
        if isinstance(given, str):
            raise ToolError(f"{given!r} is no fault; give a dict with kind, or one of tonus.faults")
        return made(given, {})
    fields = dict(given)
    if "kind" not in fields:
        raise ToolError(f"fault {fields}: has no kind; tonus fault list names the kinds")
    return made(str(fields.pop("kind")), fields)


def _name(controller: object) -> str:
    if isinstance(controller, str):
        return controller
    if not isinstance(controller, type):
        raise ToolError(f"controller: {controller!r} is no name or class; give one")
    return f"{controller.__module__}:{controller.__qualname__}"
