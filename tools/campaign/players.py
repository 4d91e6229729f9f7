"""Groups of episodes on several processors, each group in a process of its own."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from tonus.config.schema.campaign import Study
from tonus.tools.campaign.allowance import Allowance, for_torn_cables
from tonus.tools.campaign.episode import Group
from tonus.tools.campaign.judge import Row, failed
from tonus.tools.campaign.station import cause, play_group
from tonus.tools.forked_work import Tell, forked


def play(
    groups: Sequence[Group],
    study: Study,
    workers: int,
    allowance: Allowance = for_torn_cables,
) -> Iterator[Row]:
    """One row for each episode, as they come."""

    def work(number: int, tell: Tell) -> None:
        def row(row: Row) -> None:
            tell(json.dumps(row, separators=(",", ":")).encode())

        play_group(groups[number], study, row, allowance)

    waiting = [{each.index: each for each in group.episodes} for group in groups]
    for said in forked(range(len(groups)), workers, work):
        if said.line is not None:
            row: Row = json.loads(said.line)
            waiting[said.job].pop(row["index"], None)
            yield row
            continue
        why = cause(said.exit_code, study.times.hang)
        for episode in waiting[said.job].values():
            yield failed(episode, "exception", f"in bring-up: {why}")
