"""A CDR body whose strings and sequences are of known length, as a numpy record: members stand
aligned from the body's start (OMG DDS-XTypes, plain CDR), so that many bodies are filled at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Body:
    """Members in order; those with a value are the same in every message."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._formats: list[str | tuple[str, tuple[int, ...]]] = []
        self._offsets: list[int] = []
        self._values: dict[str, object] = {}
        self._size = 0

    def put(self, name: str, code: str, *shape: int, value: object = None) -> Body:
        """A number, or an array of them without its length."""
        dtype = np.dtype(code)
        self._size += -self._size % dtype.itemsize
        self._names.append(name)
        self._formats.append((code, shape) if shape else code)
        self._offsets.append(self._size)
        self._size += dtype.itemsize * int(np.prod(shape, dtype=int))
        if value is not None:
            self._values[name] = value
        return self

    def text(self, name: str, value: str) -> Body:
        """A string, its length before it and a zero behind it."""
        data = value.encode() + b"\0"
        self.put(f"{name}.length", "<u4", value=len(data))
        return self.put(name, "u1", len(data), value=np.frombuffer(data, np.uint8))

    def length(self, name: str, count: int) -> Body:
        """How many elements follow in a sequence."""
        return self.put(f"{name}.length", "<u4", value=count)

    def stamp(self, name: str) -> Body:
        """builtin_interfaces/Time, in nanoseconds once `set_stamp` has put it there."""
        return self.put(f"{name}.sec", "<i4").put(f"{name}.nanosec", "<u4")

    def header(self, name: str, frame: str) -> Body:
        """std_msgs/Header."""
        return self.stamp(f"{name}.stamp").text(f"{name}.frame_id", frame)

    def template(self) -> NDArray[np.void]:
        """One body (1,) with what is constant filled in."""
        record = np.zeros(
            1,
            np.dtype(
                {
                    "names": self._names,
                    "formats": self._formats,
                    "offsets": self._offsets,
                    "itemsize": self._size,
                }
            ),
        )
        for name, value in self._values.items():
            record[name] = value
        return record


def set_stamp(bodies: NDArray[np.void], name: str, time_ns: NDArray[np.int64]) -> None:
    """Write times (n,) in ns into a stamp of ``bodies`` (n,)."""
    bodies[f"{name}.sec"], bodies[f"{name}.nanosec"] = np.divmod(time_ns, 1_000_000_000)


def rows(bodies: NDArray[np.void]) -> NDArray[np.uint8]:
    """The same bytes (n, size)."""
    return bodies.view(np.uint8).reshape(len(bodies), bodies.dtype.itemsize)
