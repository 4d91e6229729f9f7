"""A campaign: episodes drawn, played where they have not been, judged and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tonus.config.loader import load_scenario
from tonus.config.schema.campaign import BusName, Study
from tonus.runtime.timing import clock
from tonus.tools.campaign.allowance import Allowance, for_torn_cables
from tonus.tools.campaign.draw import episodes, grouped
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.journal import Journal, fingerprint
from tonus.tools.campaign.judge import Row
from tonus.tools.campaign.players import play
from tonus.tools.check.rules import check
from tonus.tools.errors import ToolError
from tonus.tools.warm_up import warm_up


@dataclass(frozen=True)
class Standing:
    """How far a campaign has come."""

    done: int
    total: int
    kept: int
    """of these, from an earlier run"""
    broken: int
    """episodes that broke a bound"""
    seconds: float
    """s of wall time"""

    @property
    def left(self) -> float:
        """s of wall time, at the pace so far."""
        fresh = self.done - self.kept
        return self.seconds * (self.total - self.done) / fresh if fresh else 0.0


Tell = Callable[[Standing], None]


@dataclass
class Campaign:
    """What a campaign has come to."""

    episodes: list[Episode]
    rows: list[Row]
    """by index, as far as they have been played"""
    seconds: float
    kept: int
    interrupted: bool


def carry_out(
    study: Study,
    seed: int,
    buses: Sequence[BusName],
    count: int,
    out: Path,
    *,
    workers: int = 2,
    resume: bool = False,
    only: int | None = None,
    tell: Tell = lambda _: None,
    allowance: Allowance = for_torn_cables,
) -> Campaign:
    """Play ``count`` episodes, or the one number ``only``. On Ctrl-C what has been recorded stays,
    and the same call with ``resume`` goes on from there. Raises `ConfigError` and `ToolError`, also
    for what `tonus check` refuses: its episodes would tell of that and not of their faults."""
    drawn = episodes(study, seed, buses, count if only is None else only + 1)
    if only is not None:
        drawn = drawn[only:]
    _need_accepted(study, drawn)
    with Journal(out, fingerprint(study, seed, buses), resume=resume) as journal:
        wanted = {episode.index for episode in drawn}
        rows = {index: row for index, row in journal.rows.items() if index in wanted}
        kept = len(rows)
        todo = [episode for episode in drawn if episode.index not in rows]
        broken = sum(bool(row["violations"]) for row in rows.values())
        began, interrupted = clock.wall_seconds(), False
        try:
            for row in played(study, todo, workers, allowance):
                rows[row["index"]] = row
                journal.add(row)
                broken += bool(row["violations"])
                passed = clock.wall_seconds() - began
                tell(Standing(len(rows), len(drawn), kept, broken, passed))
        except KeyboardInterrupt:
            interrupted = True
    passed = clock.wall_seconds() - began
    return Campaign(drawn, [rows[index] for index in sorted(rows)], passed, kept, interrupted)


def _need_accepted(study: Study, drawn: Sequence[Episode]) -> None:
    names = {load_scenario(name).reference: name for name in study.scenarios}
    accepted: set[str] = set()
    for group in grouped(study, drawn):
        setup, scenario = group.episodes[0].setup, group.undisturbed
        named = f"{setup.overrides['control.controller']} in {names[scenario.reference]}"
        key = f"{setup.config} {named}"
        if key in accepted:
            continue
        accepted.add(key)
        for finding in check(setup.settle(), scenario):
            if not finding.ok:
                problem = f"{setup.config} with {named}: {finding.where}: {finding.text}"
                remedy = f"{finding.remedy}, or leave it out of the study"
                raise ToolError(f"study {study.name}: {problem}; {remedy}")


def played(
    study: Study, todo: Sequence[Episode], workers: int, allowance: Allowance = for_torn_cables
) -> Iterator[Row]:
    """Rows of episodes, as they come."""
    groups = grouped(study, todo)
    for group in groups:
        warm_up(group.episodes[0].setup.config)
    return play(groups, study, workers, allowance)
