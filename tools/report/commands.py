"""The page docs/commands.md: every command with its arguments and options, as its help has them.

python -m tonus.tools.report.commands > docs/commands.md
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import click

from tonus.tools.cli.main import tonus

_HEAD = """\
# Commands

For everyone who types `tonus`: every command with its options, as `--help` prints them.

Exit codes: 0 done; 1 the run ended in a fault, or a check failed; 2 bad usage or bad input, with
one line that names the place and the remedy. In a configuration file a relative name starts from
that file, on the command line from the working directory. A name in `config/` means the shipped
file from everywhere.

This page is printed from the commands (`python -m tonus.tools.report.commands`).
"""
_ELSEWHERE = {
    "tonus fault": "One command for each kind of fault, and `list`, `get` and `clear`: "
    "[Faults on demand](faults.md#from-the-command-line)."
}
"""groups whose commands have a page of their own"""


def markdown() -> str:
    """The whole page."""
    return "\n".join([_HEAD, *_sections(tonus, click.Context(tonus, info_name="tonus"))])


def _sections(group: click.Group, context: click.Context) -> Iterator[str]:
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        path = inner.command_path
        if path in _ELSEWHERE:
            yield f"## {path}\n\n{_prose(command)}\n\n{_ELSEWHERE[path]}\n"
        elif isinstance(command, click.Group):
            yield from _sections(command, inner)
        else:
            yield _section(command, inner)


def _section(command: click.Command, context: click.Context) -> str:
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    rows = []
    for parameter in command.params:
        record = parameter.get_help_record(context)
        if isinstance(parameter, click.Option) and record is not None:
            option, text = (cell.replace("|", "\\|").replace("\n", " ") for cell in record)
            rows.append(f"| `{option}` | {text} |")
    parts = [f"## {context.command_path}", f"    {usage}", _prose(command)]
    if rows:
        parts.append("\n".join(["| option | |", "|---|---|", *rows]))
    return "\n\n".join(parts) + "\n"


def _prose(command: click.Command) -> str:
    """The help text, one line a paragraph."""
    paragraphs = (command.help or "").replace("\b", "").split("\n\n")
    return "\n\n".join(" ".join(each.split()) for each in paragraphs)


if __name__ == "__main__":
    sys.stdout.write(markdown())
