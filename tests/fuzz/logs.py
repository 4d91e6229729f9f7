"""What may happen to a log, and everything that reads one."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

from click.testing import CliRunner

from tonus.config.errors import ConfigError
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError

Damage = Callable[[bytes, random.Random], bytes]
SEGMENTS = ("run.mcap", "run.2.mcap", "run.3.mcap")


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def flipped(data: bytes, rng: random.Random) -> bytes:
    turned = bytearray(data)
    for _ in range(rng.choice((1, 1, 4, 40))):
        turned[rng.randrange(len(turned))] ^= 1 << rng.randrange(8)
    return bytes(turned)


def overwritten(data: bytes, rng: random.Random) -> bytes:
    """A stretch of noise, as a bad sector leaves it, or of zeros, as a crashed file system does."""
    size = rng.choice((8, 512, 4096))
    at = rng.randrange(len(data))
    noise = rng.randbytes(size) if rng.random() < 0.5 else bytes(size)
    return (data[:at] + noise + data[at + size :])[: len(data)]


def torn(data: bytes, rng: random.Random) -> bytes:
    """A stretch that is missing."""
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.randrange(1, 4096) :]


def foreign(data: bytes, rng: random.Random) -> bytes:
    return rng.choice((b"", b"\x89", data[:8], rng.randbytes(3000), b"PK\3\4" + data[4:]))


DAMAGES: tuple[Damage, ...] = (cut, flipped, overwritten, torn, foreign)


def readers(first: Path) -> dict[str, list[str]]:
    """The arguments of every command that reads a log, by what it does."""
    out = first.parent / "out"
    found = {
        "info": [str(first)],
        "report": [str(first), "--out", str(out / "report.html")],
        "recover": [str(first), "--out", str(out / "recovered.mcap")],
        "replay": [str(first)],
        "compare": [str(first)],
        "timing": [str(first)],
        "identify": [str(first), "--out", str(out / "identify")],
        "export": [str(first), "--format", "csv", "--out", str(out / "tables")],
    }
    figure = ["figure", str(first), "--out", str(out / "figure.png")]
    merge = ["export", str(first), "--format", "mat", "--merge", "--out", str(out / "merged")]
    return {name: [name, *arguments] for name, arguments in found.items()} | {
        "merge": merge,
        "figure": figure,
    }


def read(files: dict[str, bytes], folder: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Put the files there, have every command read them, and check what became of it. Gives how
    each ended: ``done``, ``failed`` (a check of the command's own) or its one line."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "out").mkdir(parents=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    ended = {}
    for name, arguments in readers(folder / SEGMENTS[0]).items():
        if name not in names:
            continue
        result = CliRunner().invoke(command, arguments)
        if isinstance(result.exception, ToolError | ConfigError):
            text = str(result.exception)
            assert "\n" not in text, f"{name}: more than one line: {text}"
            assert str(folder) in text, f"{name}: names no file: {text}"
            ended[name] = text
        elif result.exception is None or isinstance(result.exception, SystemExit):
            assert result.exit_code in (0, 1), f"{name}: exit code {result.exit_code}"
            ended[name] = "failed" if result.exit_code else "done"
        else:
            raise AssertionError(f"{name}: {result.exception!r}") from result.exception
    for name, data in files.items():
        assert (folder / name).read_bytes() == data, f"{name} was touched"
    assert sorted(each.name for each in folder.iterdir()) == sorted([*files, "out"])
    return ended
