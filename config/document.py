"""A YAML document with the line of every key, so that an error can say where it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from os.path import normpath
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.constructor import SafeConstructor
from yaml.reader import ReaderError

from tonus.config.errors import ConfigError

Key = tuple[str | int, ...]
_NAMES = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:int")
"""What a key may be: a plain word, or an axis' number, which then is a text too."""
_PLAIN = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")
"""What a mapping or a list may be; any other tag asks for an object of a program."""
Scalar = str | int | float | bool | None
INCLUDE = "!include"
IS_DIRECTORY, IS_DEVICE = "is a directory", "is a device or a pipe, not a file"


@dataclass
class Document:
    """Plain data, and for each path in it the file and line it came from."""

    data: Any
    places: dict[Key, tuple[str, int]] = field(default_factory=dict)
    included: dict[Key, tuple[str, int]] = field(default_factory=dict)
    """where the keys stand whose values are of other files"""
    folders: dict[str, Path] = field(default_factory=dict)
    """of the files by their names in ``places``: what a relative name in one of them starts from"""

    def place(self, key: Key) -> tuple[str, int]:
        """The nearest known place at or above ``key``."""
        while key and key not in self.places:
            key = key[:-1]
        return self.places.get(key, ("", 0))

    def key_place(self, key: Key) -> tuple[str, int]:
        """Where the key itself stands, also if its value is of another file."""
        return self.included.get(key) or self.place(key)

    def folder(self, key: Key) -> Path:
        """Where the file lies in which ``key`` stands."""
        return self.folders.get(self.place(key)[0], Path())


DATA_SHEET = "eds"
"""A key whose value names a data sheet beside the file: its text is read with the configuration."""


def read(path: Path, shown: str | None = None) -> Document:
    """Parse one file; ``!include other.yaml`` (relative to the file) brings in another."""
    document = Document(None)
    document.data = _file(path, shown or str(path), (), document, ())
    return document


class _Composer(yaml.SafeLoader):
    """Without aliases: one could hold itself, and the line of what it repeats would be wrong."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise ComposerError(None, None, "aliases (*) are not used here", mark)
        return super().compose_node(parent, index)


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have is not one."""
    try:
        return path.is_file()
    except OSError:
        return False


def no_file(path: Path) -> str:
    """What a name that is not one of a file stands for."""
    try:
        if path.is_dir():
            return IS_DIRECTORY
        return IS_DEVICE if path.exists() else "there is no such file"
    except OSError:
        return "cannot be the name of a file"


def _file(path: Path, shown: str, key: Key, document: Document, chain: tuple[Path, ...]) -> Any:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise ConfigError(shown, 0, "", reason, "check the path and its permissions") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ConfigError(shown, line, "", "is not UTF-8 text", "save it as UTF-8") from error
    document.folders[shown] = path.parent
    node = _compose(text, shown)
    if node is None:
        raise ConfigError(shown, 1, "", "is empty", "write its keys, see docs/configuration.md")
    return _node(node, path, shown, key, document, (*chain, path.resolve()))


def _compose(text: str, shown: str) -> yaml.Node | None:
    try:
        return _tree(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 0
        problem = f"not valid YAML: {error.problem or error.context}"
        raise ConfigError(shown, line, "", problem, "correct the syntax there") from error
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"holds the character {chr(error.character)!a}"
        raise ConfigError(shown, line, "", problem, "remove it") from error
    except (
        ValueError,
        OverflowError,
    ) as error:  # e.g. an escape beyond the last character there is
        problem = f"not valid YAML: {error}"
        raise ConfigError(shown, 0, "", problem, "correct the syntax") from error
    except RecursionError as error:
        raise ConfigError(shown, 0, "", "is nested too deeply", "flatten it") from error


@lru_cache(maxsize=128)
def _tree(text: str) -> yaml.Node | None:
    """Kept, since most of the time to load a configuration is spent here, and a study or a test run
    loads the same files again and again. Who is given it changes nothing in it."""
    return yaml.compose(text, Loader=_Composer)


def _node(
    node: yaml.Node, path: Path, shown: str, key: Key, document: Document, chain: tuple[Path, ...]
) -> Any:
    line = node.start_mark.line + 1
    document.places[key] = (shown, line)
    if node.tag == INCLUDE:
        return _included(node, path, shown, key, document, chain)
    if not isinstance(node, yaml.ScalarNode) and node.tag not in _PLAIN:
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        problem = f"is a mapping or list of kind {kind}"
        raise ConfigError(shown, line, dotted(key), problem, "remove the tag that begins with !")
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        for name_node, value_node in node.value:
            name = _name(name_node, shown, key)
            if name in result:
                first = document.key_place((*key, name))[1]
                raise ConfigError(
                    shown,
                    name_node.start_mark.line + 1,
                    dotted((*key, name)),
                    f"given twice, first on line {first}",
                    "keep one of the two",
                )
            result[name] = _node(value_node, path, shown, (*key, name), document, chain)
            if name == DATA_SHEET and isinstance(result[name], str):
                result[name] = _sheet(result[name], path, shown, (*key, name), document)
            # An included value keeps its own file; any other is where its key stands.
            places = document.included if value_node.tag == INCLUDE else document.places
            places[(*key, name)] = (shown, name_node.start_mark.line + 1)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [
            _node(item, path, shown, (*key, index), document, chain)
            for index, item in enumerate(node.value)
        ]
    return _scalar(node, shown, line, key)


def _included(
    node: yaml.Node, path: Path, shown: str, key: Key, document: Document, chain: tuple[Path, ...]
) -> Any:
    line = node.start_mark.line + 1
    if not isinstance(node, yaml.ScalarNode):
        problem = "!include takes one file name"
        raise ConfigError(shown, line, dotted(key), problem, "write !include other.yaml")
    name = node.value
    other = path.parent / name
    if not is_file(other):
        problem = f"!include {name}: {no_file(other)}"
        remedy = f"looked for it at {other}"
        if problem.endswith(IS_DIRECTORY):
            remedy = "name a file in it"
        raise ConfigError(shown, line, dotted(key), problem, remedy)
    if other.resolve() in chain:
        problem = f"!include {name}: that file includes this one"
        raise ConfigError(shown, line, dotted(key), problem, "break the circle")
    return _file(other, normpath(Path(shown).parent / name), key, document, chain)


def _sheet(name: str, path: Path, shown: str, key: Key, document: Document) -> dict[str, str]:
    other = path.parent / name
    place = document.places[key]
    try:
        text = other.read_text(encoding="latin-1")
    except OSError as error:
        problem = f"{name} cannot be read: {error.strerror}"
        raise ConfigError(*place, dotted(key), problem, f"looked for it at {other}") from error
    document.folders[normpath(Path(shown).parent / name)] = other.parent
    return {"name": other.name, "text": text}


def _name(node: yaml.Node, shown: str, key: Key) -> str:
    if isinstance(node, yaml.ScalarNode) and node.tag in _NAMES:
        return str(node.value)
    what = repr(node.value) if isinstance(node, yaml.ScalarNode) else "a list or mapping"
    raise ConfigError(
        shown,
        node.start_mark.line + 1,
        dotted(key),
        f"{what} is no key",
        "a key is a plain word or a number",
    )


def _scalar(node: yaml.Node, shown: str, line: int, key: Key) -> Scalar:
    kind = node.tag.removeprefix("tag:yaml.org,2002:")
    if kind not in ("null", "bool", "int", "float", "str"):
        problem = f"{node.value!r} is a value of kind {kind}"
        remedy = "use a number, a text in quotes, true, false or !include"
        raise ConfigError(shown, line, dotted(key), problem, remedy)
    try:
        value: Scalar = SafeConstructor().construct_object(node)
    except (ValueError, KeyError) as error:
        problem = f"{node.value!r} cannot be read as {kind}"
        raise ConfigError(shown, line, dotted(key), problem, "correct the value") from error
    return value


def dotted(key: Key) -> str:
    """A path as errors show it."""
    return ".".join(str(part) for part in key)
