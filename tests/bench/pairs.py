"""Pairs of faults: each pair is played together and each of its faults alone, on the same robot at
the same moments. Pairs whose outcome differs from that of either single fault go, with ``--write``,
into docs/fault_pairs.md."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
from rich.console import Console

from tests.bench.pages import Marks, today
from tonus.config.loader import HERE, load_study
from tonus.config.schema.campaign import Study
from tonus.tools.campaign.campaign import played
from tonus.tools.campaign.draw import begins, episodes, undisturbed
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.judge import Row

_FASTER = 1.25
"""a pair is worse where its peak speed exceeds that of both faults alone by this factor"""
_DISTINCT_M_S = 0.1
"""m/s; and by at least so much, so that two slow stops do not count"""
HEAD = [
    "| pair | first | then | in | first alone | second alone | both | peak speed m/s |",
    "|---" * 8 + "|",
]


class Outcome(NamedTuple):
    """What became of an episode, as far as two of them are compared."""

    mode: str
    """of the stop, the last one in the order of `StopMode`"""
    fault: str
    state: str
    broken: tuple[str, ...]
    """invariants"""

    @classmethod
    def of(cls, row: Row) -> Outcome:
        broken = sorted({each["invariant"] for each in row["violations"]})
        return cls(row["stop_mode"], row["fault"], row["state"], tuple(broken))

    def __str__(self) -> str:
        bounds = f"; broke {', '.join(self.broken)}" if self.broken else ""
        return f"`{self.fault}`, {self.mode}, {self.state}{bounds}"


def only_pairs(study: Study) -> Study:
    """The study with two faults in every episode, the nominal robot and no further commands."""
    return study.model_copy(
        update={
            "faults": {"two": 1.0},
            "plants": study.plants.model_copy(update={"drawn": 0.0}),
            "commands": study.commands.model_copy(update={"chance": 0.0}),
            "controllers": study.controllers[:1],
        }
    )


def split(study: Study, pair: Episode) -> list[Episode]:
    """A pair, its first fault alone and its second fault alone, with indices 3 n, 3 n + 1, 3 n + 2
    where the pair had n."""
    found = []
    faults = pair.scenario.lab.faults
    for offset, kept in enumerate((faults, faults[:1], faults[1:])):
        lab = pair.scenario.lab.model_copy(update={"faults": kept})
        scenario = pair.scenario.model_copy(update={"lab": lab})
        update = {
            "scenario": scenario,
            "begins": begins(undisturbed(study, pair.setup, scenario), scenario),
            "index": 3 * pair.index + offset,
        }
        found.append(pair.model_copy(update=update))
    return found


def differs(both: Row, first: Row, second: Row) -> bool:
    """Whether a pair's outcome is neither that of its first fault alone nor of its second."""
    if Outcome.of(both) not in (Outcome.of(first), Outcome.of(second)):
        return True
    single = max(first["speed"], second["speed"])
    return bool(both["speed"] > max(_FASTER * single, single + _DISTINCT_M_S))


def fault_text(fault: Mapping[str, Any]) -> str:
    """A fault in a cell of the table: its kind and its values, without its time."""
    values = [
        f"{key} {_number(value)}" for key, value in fault.items() if key not in ("kind", "at")
    ]
    return f"`{fault['kind']}` {', '.join(values)}".rstrip()


def _number(value: Any) -> str:
    if isinstance(value, list):
        return "(" + " ".join(_number(each) for each in value) + ")"
    return f"{value:.2g}" if isinstance(value, float) else str(value)


def table(rows: Mapping[int, Row]) -> list[str]:
    """The pairs that differ, a line each. ``rows``: all, by index."""
    lines = list(HEAD)
    for index in sorted(rows)[::3]:
        both, first, second = (rows[index + offset] for offset in range(3))
        if not differs(both, first, second):
            continue
        one, other = both["episode"]["scenario"]["lab"]["faults"]
        apart = 1e3 * (other["at"] - one["at"])
        speeds = " / ".join(f"{row['speed']:.2f}" for row in (first, second, both))
        lines.append(
            f"| {index // 3} | {fault_text(one)} | {fault_text(other)}, {apart:.0f} ms later "
            f"| {both['episode']['state']} | {Outcome.of(first)} | {Outcome.of(second)} "
            f"| {Outcome.of(both)} | {speeds} |"
        )
    return lines


def text(rows: Mapping[int, Row], count: int, seed: int) -> str:
    """What goes into the page."""
    lines = table(rows)
    found = len(lines) - len(HEAD)
    told = (
        f"{count} pairs, {len(rows)} episodes on the *direct* bus, seed {seed}, {today()} "
        f"(`python -m tests.bench.pairs --pairs {count} --seed {seed} --write`). "
        f"{found} pairs have an outcome that neither fault has alone:"
    )
    return "\n".join([told, "", *lines])


def play(study: Study, count: int, seed: int, workers: int, out: Path) -> dict[int, Row]:
    """All rows by index; each is on the disk before the next is asked for."""
    pairs = episodes(study, seed, ("direct",), count)
    todo = [each for pair in pairs for each in split(study, pair)]
    rows: dict[int, Row] = {}
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("w", encoding="utf-8") as journal:
        for row in played(study, todo, workers):
            rows[row["index"]] = row
            journal.write(json.dumps(row) + "\n")
            journal.flush()
    return rows


def read(path: Path) -> dict[int, Row]:
    """The rows of an earlier run."""
    lines: Sequence[str] = path.read_text(encoding="utf-8").splitlines()
    return {row["index"]: row for row in map(json.loads, lines)}


@click.command()
@click.option("--pairs", "count", type=click.IntRange(1), default=70, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True)
@click.option("--out", type=Path, default=Path("out/pairs.jsonl"), show_default=True)
@click.option("--read", "again", is_flag=True, help="Only print the table of an earlier --out.")
@click.option("--write", "written", is_flag=True, help="Put the table into docs/fault_pairs.md.")
def main(count: int, seed: int, workers: int, out: Path, *, again: bool, written: bool) -> None:
    """Play pairs of faults, and each fault of a pair alone."""
    study = only_pairs(load_study("faults"))
    rows = read(out) if again else play(study, count, seed, workers, out)
    found = text(rows, len(rows) // 3, seed)
    Console(highlight=False, soft_wrap=True, markup=False).print(found)
    if written:
        Marks(HERE.parent / "docs" / "fault_pairs.md", "pairs").fill(found)


if __name__ == "__main__":
    main()
