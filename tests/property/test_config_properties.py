"""Whatever is done to the files, the loader gives a configuration or raises a `ConfigError`."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import Config, ConfigError, load
from tonus.config.loader import HERE

FILES = sorted(
    file.relative_to(HERE).as_posix()
    for file in (HERE / "can.yaml", *HERE.glob("*/*.yaml"), *HERE.glob("*.yaml"))
    if file.parent.name != "scenarios" and file.name not in ("can1.yaml", "direct.yaml")
)
FRAGMENTS = [
    "", "-", ":", "?", "- -", "{", "}", "[", "]", "&a", "*a", "&a [*a]", "<<: {a: 1}", "!include",
    "!include .", "!include control.yaml", "!include [x]", "!!int x", "!!bool x", "!!float x",
    "!!timestamp x", "!!binary x", "!!set {a}", "!!python/object:os.system x", "---", "...",
    "%YAML 9.9", "0x_", "0b_", "._", "-.inf", ".nan", "1e999", "9" * 5000, "1:99:99", "2026-99-99",
    "yes", "~", "|", ">", "'", '"', '"\\xZZ"', '"\\UFFFFFFFF"', "\x00", "\x1b", "\ufeff", "\t",
    "\u2028", "# x", "a: b: c", "a: 1", "a: [1, {b: c}]", "7: 8", "? [a]\n: b", "null: null",
]  # fmt: skip


def indented(text: str, original: str) -> str:
    """In the place of a line, or of its value."""
    return original[: len(original) - len(original.lstrip())] + text


def value_replaced(text: str, original: str) -> str:
    name, colon, _ = original.partition(":")
    return f"{name}{colon} {text}"


LINES = st.one_of(
    st.sampled_from(FRAGMENTS),
    st.floats().map(str),
    st.integers().map(str),
    st.text(max_size=12),
)
CHANGES = st.tuples(
    st.integers(0, 10_000),
    st.sampled_from(["delete", "replace", "value", "insert", "swap", "cut"]),
    LINES,
)


def mutated(text: str, change: tuple[int, str, str]) -> str:
    place, how, new = change
    lines = text.split("\n")
    at = place % len(lines)
    if how == "delete":
        del lines[at]
    elif how == "replace":
        lines[at] = indented(new, lines[at])
    elif how == "value":
        lines[at] = value_replaced(new, lines[at])
    elif how == "insert":
        lines.insert(at, indented(new, lines[at]))
    elif how == "swap":
        lines[at], lines[at - 1] = lines[at - 1], lines[at]
    else:
        lines[at] = lines[at][: place % (len(lines[at]) + 1)]
    return "\n".join(lines)


def answered(path: Path) -> Config | ConfigError:
    try:
        return load(path)[0]
    except ConfigError as error:
        return error


@settings(max_examples=75, deadline=None)
@given(file=st.sampled_from(FILES), changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_the_loader_raises_nothing_but_its_own_error(
    file: str, changes: list[tuple[int, str, str]]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "mine"
        ignored = shutil.ignore_patterns("__pycache__", "*.py", "schema", "scenarios")
        shutil.copytree(HERE, folder, ignore=ignored)
        path = folder / file
        text = path.read_text(encoding="utf-8")
        for change in changes:
            text = mutated(text, change)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        answer = answered(folder / "can.yaml")
    if isinstance(answer, ConfigError):
        assert len(str(answer).splitlines()) == 1
        assert answer.file
        assert answer.remedy


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=80))
def test_any_bytes_are_answered(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "any.yaml"
        path.write_bytes(data)
        answer = answered(path)
    assert isinstance(answer, ConfigError)
    assert len(str(answer).splitlines()) == 1
