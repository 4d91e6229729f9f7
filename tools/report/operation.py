"""The tables of docs/operation.md: what may be asked of a daemon, and what a status tells.

python -m tonus.tools.report.operation
"""

from __future__ import annotations

import sys

from tonus.runtime.operation.control_door import STATUS
from tonus.runtime.operation.verbs import VERBS


def tables() -> str:
    """Verbs, then the fields of a status."""
    rows = ["| op | |", "|---|---|"]
    rows += [f"| `{verb.name}` | {verb.about} |" for verb in VERBS.values()]
    rows += ["", "| field | JSON | meaning |", "|---|---|---|"]
    rows += [f"| `{name}` | {kind} | {about} |" for name, (kind, about) in STATUS.items()]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(tables())
