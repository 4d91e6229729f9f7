"""A group that imports a command when it is asked for, so that a light one does not wait for the
libraries of the others, and their list waits for none."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from importlib import import_module
from typing import Any

import click


class LazyGroup(click.Group):
    """Each command is the object of its name, in the module of its name."""

    def __init__(self, *, package: str, lines: Mapping[str, str], **settings: Any) -> None:
        """``lines``: the commands, in their order, and what the list says of each."""
        super().__init__(**settings)
        self._package, self.lines = package, lines

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(self.lines)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in self.lines:
            return None
        command = getattr(import_module(f"{self._package}.{cmd_name}"), cmd_name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """With the nearest name for one that is unknown; click looks among those it has loaded."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError:
            close = get_close_matches(args[0], self.lines, 1)
            if close:
                ctx.fail(f"No such command {args[0]!r} (did you mean {close[0]}?)")
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(self.lines.items()))
