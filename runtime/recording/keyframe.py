"""A control cycle's whole memory as bytes, so that a replay may begin in mid-log.

The walk goes over attributes, tuples and lists of our own objects, and notes what differs from a
cycle just made: configuration is not state and stays out. Objects and arrays that are one and the
same stay so, and so does a view of an array that the walk has met before it. The form is a line of
JSON and the arrays' bytes; nothing in it is executed.

A tick has no time for that walk. It only copies what may change (`_Still`), in a seventh of the
time, and the ticks after it find the paths and write them down, a few each.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from enum import Enum
from itertools import islice
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, NamedTuple, TypeVar, cast

import clarabel
import numpy as np
from pydantic import BaseModel

from tonus.runtime.errors import DaemonError
from tonus.runtime.signals import CycleRecord

VERSION = 1
FROM_A_KEYFRAME = {"begins": "keyframe"}
"""metadata of a log whose first record is not a run's first tick, but has a keyframe"""
_CONSTANT = (BaseModel, FunctionType, clarabel.DefaultSolver)
"""Settings, functions, and a solver that starts from nothing each time."""
_NUMBER = (int, float, np.generic)
_HEAP_TYPE = 1 << 9
"""Py_TPFLAGS_HEAPTYPE: a class made by a class statement, without memory in C"""
_LEAVES = (float, int, str, type(None), np.generic, Enum)


class _Among(dict[type, bool]):
    """Whether a class is one of some, or made from one; asked once for each, since a class of
    settings takes microseconds to say it."""

    def __init__(self, kinds: tuple[type, ...]) -> None:
        self._kinds = kinds

    def __missing__(self, kind: type) -> bool:
        self[kind] = issubclass(kind, self._kinds)
        return self[kind]


_LEAF, _FIXED = _Among(_LEAVES), _Among(_CONSTANT)
Owner = TypeVar("Owner")
Flat = dict[str, "Entry"]
ENTRIES_A_STEP = 20
"""What is written down in one tick: some 40 us."""


class KeyframeError(DaemonError):
    """The bytes are no keyframe, or not one of such a cycle."""


class Entry(NamedTuple):
    """What stands at a path: ``kind`` and what it takes to make it again."""

    kind: str
    value: Any
    data: bytes = b""


class Keyframe:
    """Takes keyframes of one ``owner``, handed over before its first tick."""

    def __init__(self, owner: object) -> None:
        self._owner = owner
        self._kinds: dict[type, int] = {}
        self._initial = _flat(owner)

    def take(self) -> bytes:
        """What has changed since the owner was made. Raises `KeyframeError`."""
        (data,) = filter(None, self._written(_Still(self._owner, self._kinds)))
        return data

    def steps(self) -> Iterator[bytes]:
        """The same in many steps, each short, of which the last gives the keyframe and the others
        nothing. The first one sees the owner's state; the others do not look at it."""
        try:
            still = _Still(self._owner, self._kinds)
        except KeyframeError:
            # Something new in mid-run: control goes on, and a replay begins at an earlier one.
            while True:
                yield b""
        yield b""
        yield from self._written(still)

    def _written(self, still: _Still) -> Iterator[bytes]:
        initial, rows, blobs, at = self._initial, {}, [], 0
        entries = _walk("", self._owner, still, {})
        while some := list(islice(entries, ENTRIES_A_STEP)):
            for path, entry in some:
                if initial.get(path) == entry:
                    continue
                rows[path] = [entry.kind, entry.value]
                if entry.data:
                    rows[path] += [at, len(entry.data)]
                    blobs.append(entry.data)
                    at += len(entry.data)
            yield b""
        head = json.dumps({"version": VERSION, "state": rows}, separators=(",", ":"))
        yield head.encode() + b"\n" + b"".join(blobs)


class _Still:
    """What was in the arrays, containers and attributes that can be reached from an owner."""

    def __init__(self, owner: object, kinds: dict[type, int]) -> None:
        """``kinds`` remembers what is done with which type."""
        self.attributes: dict[int, dict[str, Any]] = {}
        self.items: dict[int, list[Any]] = {}
        self.contents: dict[int, bytes] = {}
        # While they are kept their numbers are nobody else's.
        self._kept: list[Any] = []
        attributes, items, contents, kept = self.attributes, self.items, self.contents, self._kept
        left: list[Any] = [owner]
        while left:
            value = left.pop()
            kind = kinds.get(type(value))
            if kind is None:
                kind = kinds[type(value)] = _kind(value)
            if kind == _UNCHANGING:
                continue
            key = id(value)
            if kind == _ARRAY:
                if key not in contents:
                    contents[key] = value.tobytes()
                    kept.append(value)
            elif kind == _RECORD:
                if key not in contents:
                    contents[key] = value.data.tobytes()
                    kept.append(value)
            elif kind == _CONTAINER:
                if key not in items:
                    items[key] = inside = _items(value)
                    kept.append(value)
                    left += inside
            elif key not in attributes:
                attributes[key] = inner = vars(value).copy()
                kept.append(value)
                left += inner.values()


_UNCHANGING, _ARRAY, _RECORD, _CONTAINER, _OBJECT = range(5)


def _kind(value: Any) -> int:
    """Raises `KeyframeError` for what a keyframe cannot hold."""
    if isinstance(value, (*_LEAVES, *_CONSTANT)):
        return _UNCHANGING
    if isinstance(value, np.ndarray):
        return _ARRAY
    if isinstance(value, CycleRecord):
        return _RECORD
    if isinstance(value, (tuple, list, dict)):
        return _CONTAINER
    if not isinstance(value, SimpleNamespace) and not _is_plain(type(value)):
        raise KeyframeError(
            f"a keyframe cannot hold a {type(value).__qualname__}; keep a controller's memory in "
            "numbers, texts, arrays, tuples, lists, dictionaries and objects of those"
        )
    return _OBJECT


def _is_plain(kind: type) -> bool:
    """Whether all that an object of this class remembers stands in its ``__dict__``: a controller
    of somebody else's is as good as ours, a class that is not Python's own words is not."""
    if issubclass(kind, type | ModuleType | CodeType) or kind.__dictoffset__ == 0:
        return False
    return all(each is object or each.__flags__ & _HEAP_TYPE for each in kind.__mro__) and not any(
        vars(each).get("__slots__") for each in kind.__mro__
    )


def restore(data: bytes, fresh: Owner) -> Owner:
    """A cycle in the state that `Keyframe.take` saw, from one just made of the same configuration.
    ``fresh`` is used up. Raises KeyframeError."""
    flat = _flat(fresh)
    flat.update(_parse(data))
    built: Owner = _Builder(flat, fresh).build("", fresh)
    return built


def _parse(data: bytes) -> Flat:
    head, newline, blobs = data.partition(b"\n")
    try:
        document = json.loads(head)
        if not newline or document["version"] != VERSION:
            raise KeyframeError("a keyframe of another version")
        flat: Flat = {}
        for path, (kind, value, *place) in document["state"].items():
            at, size = place or (0, 0)
            if at + size > len(blobs):
                raise KeyframeError("a keyframe that is cut short")
            flat[path] = Entry(str(kind), value, blobs[at : at + size])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise KeyframeError(f"not a keyframe ({error})") from error
    return flat


def _flat(owner: object) -> Flat:
    """Every path of an object's state, in the order of its attributes."""
    return dict(_walk("", owner, _Still(owner, {}), {}))


def _walk(
    path: str, value: Any, still: _Still, seen: dict[int, str]
) -> Iterator[tuple[str, Entry]]:
    if _LEAF[type(value)]:
        yield path, _leaf(value)
        return
    key = id(value)
    known = seen.setdefault(key, path)
    if known != path:
        yield path, Entry("same", known)
    elif isinstance(value, np.ndarray) and id(value.base) in seen:
        shape, strides = list(value.shape), list(value.strides)
        owner, whole = seen[id(value.base)], cast(np.ndarray[Any, Any], value.base)
        offset = value.ctypes.data - whole.ctypes.data
        yield path, Entry("view", [owner, value.dtype.str, offset, shape, strides])
    elif isinstance(value, np.ndarray):
        yield path, Entry("array", [value.dtype.str, list(value.shape)], still.contents[key])
    elif isinstance(value, CycleRecord):
        yield path, Entry("record", None, still.contents[key])
    elif isinstance(value, (tuple, list, dict)):
        items = still.items[key]
        size = len(items) // 2 if isinstance(value, dict) else len(items)
        yield path, Entry(type(value).__name__, size)
        for index, item in enumerate(items):
            yield from _walk(f"{path}.{index}", item, still, seen)
    else:
        yield path, Entry("object", type(value).__name__)
        for name, item in still.attributes[key].items():
            if not _FIXED[type(item)]:
                yield from _walk(f"{path}.{name}", item, still, seen)


def _leaf(value: Any) -> Entry:
    if isinstance(value, Enum):
        return Entry("enum", [type(value).__name__, value.value])
    if isinstance(value, np.generic):
        return Entry("scalar", value.dtype.str, value.tobytes())
    if isinstance(value, float):
        # As text a NaN equals itself, and -0.0 is not 0.0.
        return Entry("float", value.hex())
    return Entry("plain", value)


def _items(value: Any) -> list[Any]:
    """What a container holds, of a dictionary each key before its value."""
    if isinstance(value, dict):
        return [each for pair in value.items() for each in pair]
    return list(value)


def _attributes(value: object) -> Iterator[tuple[str, Any]]:
    """Of an object of ours, without what is no state."""
    for name, item in vars(value).items():
        if not isinstance(item, _CONSTANT):
            yield name, item


class _Builder:
    """Makes objects from their flat form; what is not state comes from those of a fresh owner."""

    def __init__(self, flat: Flat, fresh: object) -> None:
        self._flat = flat
        self._made: dict[str, Any] = {}
        self._models: dict[str, Any] = {}
        self._collect(fresh, set())

    def _collect(self, value: Any, seen: set[int]) -> None:
        """One example of each kind of object and enumeration: no other kind can be asked for."""
        if isinstance(value, Enum):
            self._models.setdefault(type(value).__name__, type(value))
        leaf = isinstance(value, (*_LEAVES, np.ndarray, CycleRecord))
        if leaf or id(value) in seen:
            return
        seen.add(id(value))
        if isinstance(value, (tuple, list, dict)):
            inner = _items(value)
        else:
            self._models.setdefault(type(value).__name__, value)
            inner = [item for _, item in _attributes(value)]
        for item in inner:
            self._collect(item, seen)

    def build(self, path: str, model: Any) -> Any:
        """What stands at ``path``; ``model`` is what stands there in the fresh owner."""
        entry = self._flat.get(path)
        if entry is None:
            raise KeyframeError(f"a keyframe without {path or 'a beginning'}")
        try:
            return self._build(path, entry, model)
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise KeyframeError(f"a keyframe that does not fit at {path} ({error})") from error

    def _build(self, path: str, entry: Entry, model: Any) -> Any:
        kind, value = entry.kind, entry.value
        if kind == "same":
            return self._made[value]
        made: Any
        if kind == "plain":
            made = value
        elif kind == "float":
            made = float.fromhex(value)
        elif kind == "enum":
            made = self._models[value[0]](value[1])
        elif kind == "scalar":
            made = np.frombuffer(entry.data, np.dtype(value))[0]
        elif kind == "array":
            dtype, shape = value
            made = np.frombuffer(entry.data, np.dtype(dtype)).reshape(shape).copy()
        elif kind == "view":
            owner, dtype, offset, shape, strides = value
            made = np.ndarray(shape, dtype, self._made[owner], offset, strides)
        elif kind == "record":
            if not isinstance(model, CycleRecord):
                raise KeyframeError(f"a keyframe with a record at {path}")
            made = CycleRecord(model.cables)
            # One of before there were the last topics is shorter.
            memory, known = made.data.view(np.uint8), np.frombuffer(entry.data, np.uint8)
            memory[: len(known)] = known
        elif kind in ("tuple", "list", "dict"):
            if not 0 <= value <= len(self._flat):
                raise KeyframeError(f"a keyframe that claims {value} items at {path}")
            count = 2 * value if kind == "dict" else value
            models = _items(model) if isinstance(model, (tuple, list, dict)) else []
            models += [None] * (count - len(models))
            items = [self.build(f"{path}.{index}", models[index]) for index in range(count)]
            if kind == "dict":
                made = dict(zip(items[::2], items[1::2], strict=True))
            else:
                made = tuple(items) if kind == "tuple" else items
        elif kind == "object":
            made = self._object(path, value, model)
        else:
            raise KeyframeError(f"a keyframe with a {kind}")
        self._made[path] = made
        return made

    def _object(self, path: str, name: str, model: Any) -> Any:
        if type(model).__name__ != name:
            model = self._models[name]
        made = self._made[path] = copy.copy(model)
        prefix = f"{path}."
        names = [key[len(prefix) :] for key in self._flat if key.startswith(prefix)]
        for attribute in dict.fromkeys(key.partition(".")[0] for key in names):
            before = getattr(model, attribute, None)
            part = self.build(prefix + attribute, before)
            if not _alike(before, part):
                raise KeyframeError(f"a keyframe that does not fit at {prefix}{attribute}")
            # Also into a frozen dataclass: it is ours and nobody has seen it yet.
            object.__setattr__(made, attribute, part)
        return made


def _alike(before: Any, part: Any) -> bool:
    """Whether one may stand for the other. Compiled code relies on the arrays' sizes."""
    if before is None or part is None:
        return True
    if isinstance(before, np.ndarray) and isinstance(part, np.ndarray):
        return before.shape == part.shape and bool(before.dtype == part.dtype)
    if isinstance(before, _NUMBER) and not isinstance(before, Enum):
        return isinstance(part, _NUMBER)
    return type(before) is type(part)
