"""What a campaign found, counted: violations by kind and invariant, and what has been covered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from typing import Any, get_args

from tonus.config.schema.campaign import BusName, Struck, Study
from tonus.tools.campaign.coverage import Pair, Pairs, pair
from tonus.tools.campaign.invariants import INVARIANTS
from tonus.tools.campaign.judge import Row

STATES: tuple[Struck, ...] = get_args(Struck)


@dataclass
class Count:
    """Of the episodes with a kind of fault."""

    episodes: int = 0
    broken: int = 0
    alone: int = 0
    """episodes with this fault and no other"""
    broken_alone: int = 0
    by_invariant: Counter[str] = field(default_factory=Counter)


@dataclass
class Table:
    """All counts of a campaign."""

    episodes: int
    broken: int
    by_invariant: Counter[str]
    by_kind: dict[str, Count]
    pairs: Pairs
    possible: dict[str, list[Pair]]
    """pairs of kinds that can be drawn together, by state"""
    kinds: list[str]
    supervised: int = 0
    """episodes in which a supervisor could stop every drive that was enabled"""
    stopped: Counter[str] = field(default_factory=Counter)
    """episodes that it stopped, by the requirement"""
    found_before: int = 0
    """of these, in which the daemon had found a fault by then"""

    def as_json(self) -> dict[str, Any]:
        return {
            "episodes": self.episodes,
            "broken": self.broken,
            "by_invariant": dict(self.by_invariant),
            "supervised": self.supervised,
            "stopped": dict(self.stopped),
            "found_before": self.found_before,
            "by_kind": {
                name: {
                    "episodes": count.episodes,
                    "broken": count.broken,
                    "alone": count.alone,
                    "broken_alone": count.broken_alone,
                    "by_invariant": dict(count.by_invariant),
                }
                for name, count in sorted(self.by_kind.items())
            },
            "coverage": {
                state: {"kinds": self.singles(state), "pairs": self.met(state)} for state in STATES
            },
        }

    def singles(self, state: str) -> tuple[int, int]:
        """Kinds that struck in a state, and those there are."""
        seen = sum(self.pairs.single(state, kind) > 0 for kind in self.kinds)
        return seen, len(self.kinds)

    def met(self, state: str) -> tuple[int, int]:
        """Pairs whose first struck in a state, and those that can be."""
        possible = self.possible[state]
        return len(possible) - len(self.pairs.missing(state, possible)), len(possible)


def table(study: Study, buses: Sequence[BusName], rows: Sequence[Row]) -> Table:
    """Count. A kind counts once in an episode, and only if it struck."""
    kinds = [name for name, kind in study.kinds.items() if set(kind.buses) & set(buses)]
    together = [
        pair(one, other)
        for one, other in combinations_with_replacement(kinds, 2)
        if set(study.kinds[one].buses) & set(study.kinds[other].buses) & set(buses)
    ]
    by_kind: dict[str, Count] = {kind: Count() for kind in kinds}
    found = Table(len(rows), 0, Counter(), by_kind, Pairs(), dict.fromkeys(STATES, together), kinds)
    for row in rows:
        names = {violation["invariant"] for violation in row["violations"]}
        struck = [strike["kind"] for strike in row["strikes"]]
        found.broken += bool(names)
        found.by_invariant.update(names)
        _supervised(found, row["supervisor"])
        if struck:
            found.pairs.add(met_in(row), struck)
        for kind in set(struck):
            count = by_kind.setdefault(kind, Count())
            count.episodes += 1
            count.broken += bool(names)
            count.by_invariant.update(names)
            if len(struck) == 1:
                count.alone += 1
                count.broken_alone += bool(names)
    return found


def _supervised(found: Table, account: dict[str, Any] | None) -> None:
    if account is None:
        return
    found.supervised += account["there"]
    if account["stops"]:
        first = account["stops"][0]
        found.stopped[first["requirement"]] += 1
        found.found_before += first["fault"] != "NONE"


def met_in(row: Row) -> str:
    """The state in which the first fault struck; the way down is a state of its own."""
    state: str = row["strikes"][0]["state"]
    meant: str = row["episode"].get("state", "")
    return meant if state == "SAFE_STOP" and meant == "DESCENT" else state


def lines(counted: Table) -> list[str]:
    """As a person reads it."""
    used = [name for name in INVARIANTS if counted.by_invariant[name]]
    told = [f"{counted.broken} of {counted.episodes} episodes broke a bound"]
    if counted.supervised:
        told.append(_of_the_supervisor(counted))
    if used:
        head = "".join(f"{_short(name):>11}" for name in used)
        told += ["", f"  {'kind':<16}{'episodes':>9}{'broken':>8}{'alone':>11}{head}"]
        for kind, count in sorted(counted.by_kind.items(), key=lambda item: -item[1].broken):
            if not count.episodes:
                continue
            alone = f"{count.broken_alone}/{count.alone}"
            row = "".join(f"{count.by_invariant[name] or '':>11}" for name in used)
            told.append(f"  {kind:<16}{count.episodes:>9}{count.broken:>8}{alone:>11}{row}")
        total = "".join(f"{counted.by_invariant[name]:>11}" for name in used)
        told.append(f"  {'episodes':<16}{counted.episodes:>9}{counted.broken:>8}{'':>11}{total}")
    told += ["", f"  {'first struck in':<16}{'kinds':>9}{'pairs':>12}"]
    for state in STATES:
        single, met = counted.singles(state), counted.met(state)
        told.append(f"  {state:<16}{single[0]:>5}/{single[1]:<4}{met[0]:>6}/{met[1]}")
    return told


def _of_the_supervisor(counted: Table) -> str:
    stopped = sum(counted.stopped.values())
    told = f"{counted.supervised} were supervised; the supervisor stopped {stopped}"
    if not stopped:
        return told
    by = ", ".join(f"{name} {count}" for name, count in sorted(counted.stopped.items()))
    return f"{told} ({by}), {counted.found_before} after a fault that the daemon had found"


def _short(name: str) -> str:
    return name.replace("commanded_", "cmd_").replace("stiffness", "stiff")[:10]
