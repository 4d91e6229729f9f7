"""Evaluations: done side by side, each once, and none twice after an interruption."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tonus import runtime
from tonus.config import load
from tonus.config.errors import ConfigError
from tonus.config.loader import load_tuning
from tonus.tools.campaign.play import describe
from tonus.tools.campaign.station import cause
from tonus.tools.errors import ToolError
from tonus.tools.forked_work import Tell, forked
from tonus.tools.tune.judge import Part, judge
from tonus.tools.warm_up import warm_up

Gains = dict[str, float]
"""Dotted keys below ``control``."""


class Evaluator:
    """Costs of gains on the training scenarios. What it has found it also writes to ``journal``, a
    line each, and reads from there when begun anew."""

    def __init__(
        self, config: str, tuning: str | None, seed: int, journal: Path, processes: int
    ) -> None:
        self._order = (config, tuning, seed)
        self.fingerprint = fingerprint(config, tuning, seed)
        self._journal, self._processes = journal, processes
        self._known = _read(journal, self.fingerprint)
        self.simulated = 0
        """evaluations of this run, without those the journal knew"""

    def __call__(self, controller: str, many: Sequence[Gains]) -> list[list[Part]]:
        """Each set of gains on every scenario, in order. Raises `ToolError` where one cannot be
        simulated; what has been until then is in the journal."""
        keys = [_key(controller, gains) for gains in many]
        new = {key: gains for key, gains in zip(keys, many, strict=True) if key not in self._known}
        if new:
            warm_up(self._order[0])
        for key, parts in self._played(controller, new):
            self.simulated += 1
            self._known[key] = parts
            self._note(key, parts)
        return [self._known[key] for key in keys]

    def _played(
        self, controller: str, new: Mapping[str, Gains]
    ) -> Iterator[tuple[str, list[Part]]]:
        """As they come, each in a process of its own, whose crash ends no other."""

        def work(key: str, tell: Tell) -> None:
            try:
                parts = _work((*self._order, controller, new[key]))
                found: dict[str, Any] = {"parts": [asdict(part) for part in parts]}
            except (ConfigError, ToolError) as error:
                found = {"error": str(error)}
            except Exception as error:  # noqa: BLE001 - of a controller or a model: told in a line
                found = {"error": describe(error)}
            tell(json.dumps(found).encode())

        told: set[str] = set()
        for said in forked(new, self._processes, work):
            gains = ", ".join(f"{name} {value:g}" for name, value in new[said.job].items())
            if said.line is None:
                if said.job not in told:
                    why = cause(said.exit_code, 0)
                    known = f"what was simulated before is in {self._journal}"
                    raise ToolError(f"{controller} with {gains}: {why}; {known}")
                continue
            told.add(said.job)
            found = json.loads(said.line)
            if "error" in found:
                raise ToolError(f"{controller} with {gains}: {found['error']}")
            yield said.job, [Part(**part) for part in found["parts"]]

    def _note(self, key: str, parts: list[Part]) -> None:
        line = {"for": self.fingerprint, "key": key, "parts": [asdict(part) for part in parts]}
        try:
            with self._journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise ToolError(f"{self._journal}: {error.strerror}; choose another --out") from error


def fingerprint(config: str, tuning: str | None, seed: int) -> str:
    """Of all that the cost of given gains depends on: configuration, scenarios, weights, seed, and
    the code that is run. What is searched, and how long, is no part of it."""
    rules = load_tuning(tuning)
    loaded, _ = load(config, overrides=dict(rules.overrides))
    control = loaded.control.model_dump(mode="json", exclude={"controller"})
    told: dict[str, Any] = {
        "seed": seed,
        "cost": rules.cost.model_dump(mode="json"),
        "failure": rules.failure,
        "scenarios": [scenario.model_dump(mode="json") for scenario in rules.scenarios],
        "control": _without(control, rules.controllers.values()),
        "code": _code(),
        "rest": loaded.model_dump(mode="json", include={"robot", "fieldbus", "tracker", "lab"}),
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


def _code() -> str:
    """Of the rooms that a trial runs in."""
    found = hashlib.sha256()
    root = Path(runtime.__file__).parent.parent
    for room in ("drivers", "runtime", "sim"):
        for file in sorted((root / room).rglob("*.py")):
            found.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return found.hexdigest()


def _without(control: dict[str, Any], searched: Any) -> dict[str, Any]:
    """The section without what is searched: gains that have landed change no fingerprint."""
    for ranges in searched:
        for key in ranges:
            *parents, last = key.split(".")
            place = control
            for part in parents:
                place = place.get(part, {})
            place.pop(last, None)
    return control


def _work(order: tuple[str, str | None, int, str, Gains]) -> list[Part]:
    config, tuning, seed, controller, gains = order
    rules = load_tuning(tuning)
    overrides = {f"control.{key}": value for key, value in gains.items()}
    overrides |= {"control.controller": controller, **rules.overrides}  # type: ignore[dict-item]
    loaded, _ = load(config, overrides=overrides)
    return judge(rules, loaded, seed)


def _key(controller: str, gains: Gains) -> str:
    return json.dumps([controller, sorted(gains.items())])


def _read(journal: Path, wanted: str) -> dict[str, list[Part]]:
    """What an earlier run has written; the line that it was killed in does not count."""
    known: dict[str, list[Part]] = {}
    if not journal.is_file():
        return known
    for line in journal.read_text(encoding="utf-8").splitlines():
        try:
            row = json.loads(line)
            if row["for"] == wanted:
                known[row["key"]] = [Part(**part) for part in row["parts"]]
        except (json.JSONDecodeError, KeyError, TypeError):
            continue
    return known
