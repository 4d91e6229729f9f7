"""Places in the documentation that a measurement fills."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tonus.runtime.timing.clock import wall_stamp


def today() -> str:
    """Year, month, day."""
    stamp = wall_stamp()
    return f"{stamp[:4]}-{stamp[4:6]}-{stamp[6:8]}"


@dataclass(frozen=True)
class Marks:
    """Two comments in a page, with what was measured between them."""

    page: Path
    name: str

    def fill(self, text: str) -> None:
        begin, end = f"<!-- {self.name}: begin -->", f"<!-- {self.name}: end -->"
        page = self.page.read_text(encoding="utf-8")
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"{self.page} needs {begin} and {end} once each")
        head, _, rest = page.partition(begin)
        tail = rest.partition(end)[2]
        self.page.write_text(f"{head}{begin}\n\n{text}\n\n{end}{tail}", encoding="utf-8")
