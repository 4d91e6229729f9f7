"""Where a run writes: a new folder for each, or the one asked for, where an earlier run is kept.

Nothing is deleted. An earlier run in the same folder moves to ``previous/0001`` and so on before
the new one records its first byte. If the new one then fails to start, it moves to ``failed/0001``,
and the earlier run returns to its place.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tonus.runtime.timing.clock import wall_stamp
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder

OUT = Path("out")
"""the folder of all runs, where none is asked for"""
LATEST = "latest"
"""link beside the runs' folders, to the one that started last"""
LOG = "run.mcap"
_PRODUCTS = (LOG, "run.[0-9]*.mcap", "summary.json", "overview.png")
_PREVIOUS, _FAILED = "previous", "failed"


def new_folder(config: Path, scenario: str, base: Path = OUT) -> Path:
    """A folder of its own for a run that begins now, made and empty. Raises `ToolError`."""
    make_folder(base)
    name = "-".join([wall_stamp(), _plain(config.stem), _plain(scenario)])
    number = 1
    while True:
        folder = base / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        except OSError as error:
            raise ToolError(f"{folder}: {error.strerror}; choose another with --out") from error
        else:
            return folder


def discard_empty(folder: Path) -> None:
    """Remove a folder of a run that left nothing, and that of all runs if nothing else is there."""
    with suppress(OSError):
        folder.rmdir()
        folder.parent.rmdir()


def next_folder(out: Path) -> Path:
    """OUT/0001, OUT/0002 and so on."""
    taken = [int(each.name) for each in out.glob("[0-9]*") if re.fullmatch(r"\d{4,9}", each.name)]
    return out / f"{max(taken, default=0) + 1:04d}"


class RunFolder:
    """The folder of one run while it is set up."""

    def __init__(self, path: Path, *, link: bool) -> None:
        """``link``: let ``latest`` beside the folder point to it once the run has started."""
        self.path = path
        self._link = link
        self._started = False

    def started(self) -> None:
        """The bus is up and the first tick is next: what is recorded from here on stays."""
        self._started = True
        if self._link:
            _point(self.path.parent / LATEST, self.path.name)

    @contextmanager
    def occupied(self) -> Iterator[None]:
        """Hold the folder for the run. Raises `ToolError` where it cannot be written."""
        make_folder(self.path)
        earlier = _move(self.path, next_folder(self.path / _PREVIOUS))
        try:
            yield
        finally:
            if earlier is not None and not self._started:
                _move(self.path, next_folder(self.path / _FAILED))
                _move(earlier, self.path)
                with suppress(OSError):
                    earlier.rmdir()
                    earlier.parent.rmdir()
            elif self._link and not self._started:
                with suppress(OSError):
                    self.path.rmdir()  # only where nothing was recorded


def _move(source: Path, target: Path) -> Path | None:
    """Move what a run made to another folder of the same disk; gives it, None without a run."""
    files = sorted({file for pattern in _PRODUCTS for file in source.glob(pattern)})
    if not files:
        return None
    try:
        target.mkdir(parents=True, exist_ok=True)
        for file in files:
            file.rename(target / file.name)
    except OSError as error:
        problem = f"the earlier run cannot be moved to {target}: {error.strerror}"
        raise ToolError(f"{source}: {problem}; choose another with --out") from error
    return target


def _point(link: Path, name: str) -> None:
    """Make or redirect a link at once, so that it always leads somewhere. What is no link stays."""
    if link.exists() and not link.is_symlink():
        return
    fresh = link.with_name(f".{link.name}-{name}")
    with suppress(OSError):  # a disk without links has none
        fresh.symlink_to(name)
        fresh.replace(link)


def _plain(text: str) -> str:
    """A name without what a shell or a file system could take for something else."""
    return re.sub(r"[^A-Za-z0-9_.]+", "_", text).strip("._") or "run"
