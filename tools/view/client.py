"""viser's client: the one file that draws the scene in a browser, and what it is spoken to in."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec.msgpack
import numpy as np
import zstandard
from numpy.typing import NDArray

from tonus.runtime.timing import clock
from tonus.tools.errors import ToolError

Message = dict[str, Any]
"""plain values and arrays, by name"""
SPOKEN = "viser-v1.1."
"""what its name of the protocol begins with; other versions may say it otherwise"""


@cache
def client_file() -> bytes:
    """The page of the scene, from which nothing else is loaded. Raises `ToolError` without it, or
    where it is of a version that `tonus.tools.view.stage` does not speak to."""
    # Not imported: its server takes a fifth of a second, and is not used.
    spec = find_spec("viser")
    if spec is None or spec.origin is None:
        raise ToolError("the viewer needs the package viser: pip install 'tonus[view]'")
    try:
        installed = version("viser")
    except PackageNotFoundError:
        installed = "of no version"
    if not f"viser-v{installed}".startswith(SPOKEN):
        raise ToolError(
            f"the viewer draws with viser 1.1, and viser {installed} is installed: "
            "pip install 'tonus[view]'"
        )
    try:
        return (Path(spec.origin).parent / "client" / "build" / "index.html").read_bytes()
    except OSError as error:
        raise ToolError(f"{error.filename}: {error.strerror}; install viser again") from error


def encoded(messages: Iterable[Message]) -> bytes:
    """As viser's client reads them: the sizes of what follows, the messages as MessagePack, packed
    with zstandard, and the arrays as they are, each at a multiple of eight bytes."""
    arrays: list[NDArray[Any]] = []
    plain = [_without_arrays(message, arrays) for message in messages]
    lengths = [array.nbytes for array in arrays]
    inner = msgspec.msgpack.encode(
        {
            "messages": plain,
            "timestampSec": clock.wall_seconds(),
            "binaryBufferLengths": lengths,
        }
    )
    packed = zstandard.ZstdCompressor(level=1).compress(inner)
    out = bytearray(len(inner).to_bytes(8, "little") + len(packed).to_bytes(8, "little") + packed)
    for array in arrays:
        out += bytes(-len(out) % 8)
        out += array.tobytes()
    return bytes(out)


def _without_arrays(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """The same, with the place of each array among ``arrays`` in place of it."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"__binary_index": len(arrays) - 1, "dtype": value.dtype.str}
    if isinstance(value, dict):
        return {name: _without_arrays(each, arrays) for name, each in value.items()}
    return value
