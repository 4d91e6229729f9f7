"""Evaluations: done side by side, each once, and none twice after an interruption."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tonus import runtime
from tonus.config import load
from tonus.config.loader import load_tuning
from tonus.tools.errors import ToolError
from tonus.tools.tune.judge import Part, judge

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
        self._journal = journal
        self._known = _read(journal, self.fingerprint)
        self._pool = (
            ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"))
            if processes > 1
            else None
        )
        self.simulated = 0
        """evaluations of this run, without those the journal knew"""

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __call__(self, controller: str, many: Sequence[Gains]) -> list[list[Part]]:
        """Each set of gains on every scenario, in order."""
        keys = [_key(controller, gains) for gains in many]
        new = {key: gains for key, gains in zip(keys, many, strict=True) if key not in self._known}
        orders = [(*self._order, controller, gains) for gains in new.values()]
        found = map(_work, orders) if self._pool is None else self._pool.map(_work, orders)
        for key, parts in zip(new, found, strict=True):
            self.simulated += 1
            self._known[key] = parts
            self._note(key, parts)
        return [self._known[key] for key in keys]

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
