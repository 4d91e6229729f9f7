"""A damaged log is used as far as it goes, said to be damaged, and costs the exit code."""

from __future__ import annotations

from collections.abc import Iterable

import click

from tonus.tools.log import Log


def tell_damage(logs: Iterable[Log]) -> None:
    """The end of a command that has printed what it found. Exits with 1 where a log is damaged."""
    damaged = [log for log in logs if log.damage]
    for log in damaged:
        click.echo(f"damaged: {log.path}: {log.damage}; used up to there", err=True)
    if damaged:
        raise click.exceptions.Exit(1)
