"""A `tonus` command in the test's process, which costs no second start of the interpreter."""

from __future__ import annotations

from typing import NamedTuple

from click.testing import CliRunner

from tonus.tools.cli.failures import explained
from tonus.tools.cli.main import tonus


class Done(NamedTuple):
    """How a command ended, and what it printed."""

    code: int
    out: str
    err: str


def command(*words: str) -> Done:
    """What the command of these words prints. An error that `explained` does not know is raised."""
    result = CliRunner().invoke(tonus, words, standalone_mode=False)
    if isinstance(result.exception, Exception):
        text, code = explained(result.exception)
        return Done(code, result.stdout, result.stderr + text)
    code = result.return_value if isinstance(result.return_value, int) else result.exit_code
    return Done(code, result.stdout, result.stderr)
