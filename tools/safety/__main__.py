"""``python -m tonus.tools.safety fmea|hazards|requirements|third_party`` prints a page of docs;
``check`` prints what does not agree, and exits with 1 if there is anything."""

from __future__ import annotations

import sys
from collections.abc import Callable

from tonus.config.errors import ConfigError
from tonus.tools.errors import ToolError
from tonus.tools.safety import pages
from tonus.tools.safety.checks import findings
from tonus.tools.safety.node_ids import collect_tests
from tonus.tools.safety.source import ROOT, Evidence, load_evidence
from tonus.tools.safety.third_party import page as third_party

PAGES: dict[str, Callable[[Evidence], str]] = {
    "fmea": pages.fmea,
    "hazards": pages.hazards,
    "requirements": pages.requirements,
    "third_party": lambda _: third_party(),
}


def main(arguments: list[str]) -> int:
    """The exit code: 0 done, 1 something does not agree, 2 bad usage or bad input."""
    if len(arguments) != 1 or arguments[0] not in (*PAGES, "check"):
        sys.stderr.write(f"usage: python -m tonus.tools.safety {'|'.join([*PAGES, 'check'])}\n")
        return 2
    try:
        evidence = load_evidence()
        if arguments[0] != "check":
            sys.stdout.write(PAGES[arguments[0]](evidence))
            return 0
        found = findings(evidence, collect_tests(ROOT / "tests"))
    except (ConfigError, ToolError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.writelines(f"{line}\n" for line in found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
