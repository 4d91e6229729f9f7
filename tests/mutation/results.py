"""What was found, by file: kept beside the mutants, and printed into docs/mutation.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
KEPT = HERE / "results.yaml"
PAGE = ROOT / "docs/mutation.md"
BEGIN, END = "<!-- mutation: begin -->", "<!-- mutation: end -->"
_TWO_SIDED_95 = 1.96


@dataclass
class Found:
    """Of one file."""

    file: str
    date: str = ""
    mutants: int = 0
    """that there are"""
    tried: int = 0
    killed: int = 0
    equivalent: int = 0
    """of those tried"""
    seconds: float = 0.0
    survivors: list[str] = field(default_factory=list)
    """keys"""

    @property
    def line(self) -> str:
        told = f"{self.file}: {self.tried} mutants, {self.killed} killed, "
        told += f"{self.equivalent} equivalent, {len(self.survivors)} survived"
        return f"{told}, {self.share}, {self.seconds:.0f} s"

    @property
    def share(self) -> str:
        """Killed of those that are not equivalent, with its interval where it is a sample."""
        told = self.tried - self.equivalent
        if not told:
            return "-"
        share = f"{100.0 * self.killed / told:.1f} %"
        if self.tried == self.mutants:
            return share
        low, high = _interval(self.killed, told)
        return f"{share} ({100.0 * low:.0f} to {100.0 * high:.0f} %)"


def _interval(killed: int, told: int) -> tuple[float, float]:
    """Wilson's, 95 %."""
    z, share = _TWO_SIDED_95, killed / told
    middle = share + z * z / (2 * told)
    half = z * math.sqrt(share * (1.0 - share) / told + z * z / (4 * told * told))
    whole = 1.0 + z * z / told
    return max(0.0, (middle - half) / whole), min(1.0, (middle + half) / whole)


def kept() -> dict[str, Found]:
    text: dict[str, dict[str, Any]] = yaml.safe_load(KEPT.read_text()) if KEPT.is_file() else {}
    return {file: Found(file, **each) for file, each in text.items()}


def keep(results: Mapping[str, Found]) -> None:
    plain = {file: asdict(each) for file, each in results.items()}
    for each in plain.values():
        del each["file"]
        each["seconds"] = round(each["seconds"])
    head = "# Written by `python -m tests.mutation --write DATE`, as is docs/mutation.md.\n"
    text = yaml.safe_dump(plain, sort_keys=False, width=1000, allow_unicode=True)
    KEPT.write_text(head + text)


def printed(results: Mapping[str, Found], reasons: Mapping[str, Mapping[str, str]]) -> str:
    """The table, and the survivors with what is said of them."""
    head = (
        "file",
        "date",
        "mutants",
        "tried",
        "killed",
        "equivalent",
        "survived",
        "killed of the rest",
    )
    rows = [head, ("---",) * len(head)]
    for each in results.values():
        counts = (each.mutants, each.tried, each.killed, each.equivalent, len(each.survivors))
        rows.append((f"`{each.file}`", each.date, *map(str, counts), each.share))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    for file, each in results.items():
        if each.survivors:
            lines += ["", f"Survivors of `{file}`:", ""]
            told = reasons.get(file, {})
            lines += [f"- `{key}`: {told.get(key, 'no test yet')}" for key in each.survivors]
    return "\n".join(lines)


def write(results: Mapping[str, Found], reasons: Mapping[str, Mapping[str, str]]) -> None:
    text = PAGE.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n\n{printed(results, reasons)}\n\n{END}{after}")
