"""`tonus campaign`: many runs. A file for each of its commands."""

from __future__ import annotations

import click

from tonus.tools.cli.lazy import LazyGroup

LINES = {
    "play": "Play every run of a study of parameters; may be left out.",
    "merge": "Put the shares of a study together.",
    "faults": "Play faults at random, each episode judged by the truth.",
}


class _PlaysByDefault(LazyGroup):
    """Takes the name of a study for ``play`` and that name."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.lines and not args[0].startswith("-"):
            args = ["play", *args]
        return super().resolve_command(ctx, args)


@click.group(cls=_PlaysByDefault, package=__name__, lines=LINES)
def campaign() -> None:
    """Many runs: a study of parameters (`tonus campaign FILE`), or faults at random."""
