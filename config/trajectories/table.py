"""A table of time and pose, from a CSV or Parquet file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.trajectory import Samples, Table
from tonus.config.trajectories.samples import TrajectoryError, splined

Array = NDArray[np.float64]
_POSITION, _ROTATION, _QUATERNION = ("x", "y", "z"), ("rx", "ry", "rz"), ("qw", "qx", "qy", "qz")
_MOST_ROWS = 60_000
"""a minute at 1 kHz: the rows travel in the log"""


def tabled(table: Table, base: Path) -> Samples:
    """Read and interpolate it. Raises `TrajectoryError`."""
    path = base / table.file
    columns = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    times, pose = _pose(table, columns)
    if table.relative_to == "start":
        pose[:, :3] -= pose[0, :3].copy()
    return splined(times, pose, table.approach)


def _pose(table: Table, columns: dict[str, Array]) -> tuple[Array, Array]:
    missing = [name for name in ("t", *_POSITION) if name not in columns]
    if missing:
        raise _wrong(table, f"has no column {missing[0]}", "give it columns t, x, y, z")
    known = {"t", *_POSITION, *_ROTATION, *_QUATERNION}
    unknown = sorted(set(columns) - known)
    if unknown:
        remedy = "rename or remove it; known are t, x, y, z, rx, ry, rz, qw, qx, qy, qz"
        raise _wrong(table, f"has a column {unknown[0]!r}", remedy)
    times = columns["t"]
    if not 2 <= len(times) <= _MOST_ROWS:
        raise _wrong(table, f"has {len(times)} rows", f"give it 2 to {_MOST_ROWS}")
    for name, column in columns.items():
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise _wrong(table, f"row {wrong[0] + 1}: {name} is no number", "correct it")
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if back.size:
        text = f"row {back[0] + 2}: t does not increase, {times[back[0] + 1]:g} s"
        raise _wrong(table, text, "sort the rows by time and remove repeated ones")
    pose = np.zeros((len(times), 6))
    pose[:, :3] = np.stack([columns[name] for name in _POSITION], axis=1)
    pose[:, 3:] = _rotation(table, columns, len(times))
    return times, pose


def _rotation(table: Table, columns: dict[str, Array], rows: int) -> Array:
    for names in (_ROTATION, _QUATERNION):
        there = [name in columns for name in names]
        if any(there) and not all(there):
            missing = names[there.index(False)]
            raise _wrong(table, f"has no column {missing}", f"give all of {', '.join(names)}")
    if "rx" in columns and "qw" in columns:
        raise _wrong(table, "has both rx and qw", "leave one kind of orientation out")
    if "rx" in columns:
        return np.stack([columns[name] for name in _ROTATION], axis=1)
    if "qw" not in columns:
        return np.zeros((rows, 3))
    quaternions = np.stack([columns[name] for name in ("qx", "qy", "qz", "qw")], axis=1)
    short = np.flatnonzero(np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 0.01)
    if short.size:
        raise _wrong(table, f"row {short[0] + 1}: the quaternion has not length 1", "normalise it")
    from scipy.spatial.transform import Rotation  # as the spline: few commands need it

    return np.asarray(Rotation.from_quat(quaternions).as_rotvec())


def _csv(path: Path) -> dict[str, Array]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise _unread(path, error) from error
    if not rows:
        raise TrajectoryError("file", f"{path} is empty", "give it columns t, x, y, z")
    names = [name.strip() for name in rows[0]]
    if len(names) == 1 and ";" in names[0]:
        text = f"{path} has semicolons between its columns"
        raise TrajectoryError("file", text, "use commas there, and points in the numbers")
    if len(set(names)) != len(names):
        raise TrajectoryError("file", f"{path} names a column twice", "rename or remove one")
    values = np.empty((len(rows) - 1, len(names)))
    for index, row in enumerate(rows[1:]):
        if len(row) != len(names):
            text = f"{path} row {index + 1}: has {len(row)} values for {len(names)} columns"
            raise TrajectoryError("file", text, "correct it")
        for column, cell in enumerate(row):
            try:
                values[index, column] = float(cell)
            except ValueError:
                text = (
                    f"{path} row {index + 1}: {names[column]} is {cell[:60]!r}, which is no number"
                )
                raise TrajectoryError("file", text, "correct it") from None
    return {name: values[:, column] for column, name in enumerate(names)}


def _parquet(path: Path) -> dict[str, Array]:
    try:
        from pyarrow import ArrowException
        from pyarrow.parquet import read_table
    except ImportError as error:
        text = f"{path} needs pyarrow"
        raise TrajectoryError("file", text, "install tonus[parquet], or save it as CSV") from error
    try:
        table = read_table(path)
        return {
            name: np.asarray(table[name].to_numpy(), dtype=np.float64)
            for name in table.column_names
        }
    except (OSError, ArrowException, ValueError, TypeError) as error:
        raise _unread(path, error) from error


def _unread(path: Path, error: Exception) -> TrajectoryError:
    said = getattr(error, "strerror", None) or str(error).splitlines()[0]
    return TrajectoryError("file", f"{path} cannot be read: {said}", "correct the path or the file")


def _wrong(table: Table, problem: str, remedy: str) -> TrajectoryError:
    return TrajectoryError("file", f"{table.file} {problem}", remedy)
