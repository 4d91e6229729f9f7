"""The robot as viewers show it: its pose, frames, winches, and cables coloured by their tension,
as standard messages, a few times a second. Made by the recorder from the cycle records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.runtime.recording.cdr import Body, rows, set_stamp
from tonus.runtime.recording.mcap_file import Announces, Block
from tonus.runtime.recording.viewer_messages import DEFINITIONS, JOINTS, MARKERS, POSE, TRANSFORMS

Array = NDArray[np.float64]

BASE, PLATFORM = "base", "platform"
_CUBE, _LINES = 1, 5
"""visualization_msgs/Marker: type"""
_SLACK = np.array([0.0, 0.0, 0.0])
_COLOURS = np.array([[0, 114, 178], [204, 204, 204], [213, 94, 0]]) / 255.0
"""low, pretension and high, told apart by the colour-blind (Okabe and Ito)"""
_CABLE_WIDTH, _FRAME_WIDTH = 0.004, 0.01
"""m, as drawn"""


@dataclass(frozen=True)
class Scene:
    """What a picture needs to know of the robot beside its cycle records."""

    ticks: int
    """from one picture to the next"""
    frame: tuple[tuple[float, float, float], ...]
    """m, anchors (n, 3) in the base frame"""
    platform: tuple[tuple[float, float, float], ...]
    """m, anchors (n, 3) in the platform frame"""
    levels: tuple[float, float, float, float]
    """N: slack, low, pretension and high, where the colours stand"""

    @classmethod
    def of(cls, config: Config) -> Scene | None:
        """None for a configuration that wants no pictures."""
        rate, tension = config.recording.viewer_hz, config.control.tension
        if not rate:
            return None
        geometry = config.robot.geometry
        return cls(
            max(1, round(1.0 / (rate * config.control.rates.period))),
            geometry.frame,
            geometry.platform,
            (tension.slack, tension.min, tension.pre, tension.max),
        )

    @classmethod
    def read(cls, written: Mapping[str, Any]) -> Scene:
        """From its fields as JSON has them, which knows no tuples."""
        frame, platform = (
            tuple((float(x), float(y), float(z)) for x, y, z in written[name])
            for name in ("frame", "platform")
        )
        slack, low, pre, high = written["levels"]
        return cls(int(written["ticks"]), frame, platform, (slack, low, pre, high))


class ViewerEncoder:
    """Messages of the ticks that are multiples of the scene's, once there is a pose."""

    def __init__(self, file: Announces, scene: Scene) -> None:
        self._scene = scene
        self._frame, self._anchors = np.array(scene.frame), np.array(scene.platform)
        names = {
            "/tf": TRANSFORMS,
            "/viewer/pose": POSE,
            "/viewer/desired": POSE,
            "/viewer/winches": JOINTS,
            "/viewer/markers": MARKERS,
        }
        self._channels = {
            topic: file.channel(topic, message, DEFINITIONS[message])
            for topic, message in names.items()
        }
        self._bodies = _bodies(scene)

    def __call__(self, log_time: NDArray[np.int64], cycles: NDArray[np.void]) -> list[Block]:
        """From UTC in ns (n,) and cycle records (n,)."""
        pose = cycles["pose"]
        known = (pose["quaternion"] != 0.0).any(axis=1)
        chosen = np.flatnonzero(known & (cycles["timing"]["tick"] % self._scene.ticks == 0))
        if not len(chosen):
            return []
        stamps, some = log_time[chosen], cycles[chosen]
        number = (some["timing"]["tick"] // self._scene.ticks).astype(np.int64)
        bodies = {topic: np.repeat(body, len(chosen)) for topic, body in self._bodies.items()}
        pose = some["pose"]
        # A quaternion stands w first in our records and last in ROS.
        turned, wanted = (
            np.roll(pose[name], -1, axis=1) for name in ("quaternion", "desired_quaternion")
        )
        places = {
            "/tf": (pose["position"], turned),
            "/viewer/pose": (pose["position"], turned),
            "/viewer/desired": (pose["desired_position"], wanted),
        }
        for topic, (place, rotation) in places.items():
            bodies[topic]["position"], bodies[topic]["rotation"] = place, rotation
        winches, drives = bodies["/viewer/winches"], some["drives"]
        for name in ("angle", "rate", "torque"):
            winches[name] = drives[name]
        self._draw(bodies["/viewer/markers"], some)
        for topic, body in bodies.items():
            for header in _HEADERS[topic]:
                set_stamp(body, f"{header}.stamp", stamps)
        return [
            Block(channel, stamps, number, rows(bodies[topic]))
            for topic, channel in self._channels.items()
        ]

    def _draw(self, markers: NDArray[np.void], some: NDArray[np.void]) -> None:
        """Each cable from its frame anchor to the platform's."""
        ends = markers["cables.points"].reshape(len(some), -1, 2, 3)
        ends[:, :, 0] = self._frame
        rotation = _matrices(some["pose"]["quaternion"])
        ends[:, :, 1] = some["pose"]["position"][:, None] + self._anchors @ rotation.swapaxes(1, 2)
        colours = markers["cables.colors"].reshape(len(some), -1, 2, 4)
        colours[..., :3] = self._colour(some["tension"]["measured"])[:, :, None]
        colours[..., 3] = 1.0

    def _colour(self, tension: Array) -> Array:
        """RGB (n, 8, 3), black where a cable is slack."""
        slack, *levels = self._scene.levels
        mixed = np.stack([np.interp(tension, levels, each) for each in _COLOURS.T], axis=-1)
        return np.where(tension[..., None] < slack, _SLACK, mixed)


_MARKED = ("frame", "platform", "cables")
_HEADERS = {
    "/tf": ("header",),
    "/viewer/pose": ("header",),
    "/viewer/desired": ("header",),
    "/viewer/winches": ("header",),
    "/viewer/markers": tuple(f"{name}.header" for name in _MARKED),
}
_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0)]
_BOX = _EDGES + [(a + 4, b + 4) for a, b in _EDGES] + [(i, i + 4) for i in range(4)]
"""pairs of the box's corners, upper ones first, that the frame's beams join"""


def _transform() -> NDArray[np.void]:
    body = Body().length("transforms", 1).header("header", BASE).text("child", PLATFORM)
    return body.put("position", "<f8", 3).put("rotation", "<f8", 4).template()


def _pose() -> NDArray[np.void]:
    body = Body().header("header", BASE)
    return body.put("position", "<f8", 3).put("rotation", "<f8", 4).template()


def _winches(cables: int) -> NDArray[np.void]:
    body = Body().header("header", "").length("name", cables)
    for number in range(cables):
        body.text(f"name{number}", f"winch{number + 1}")
    for field in ("angle", "rate", "torque"):
        body.length(field, cables).put(field, "<f8", cables)
    return body.template()


@cache
def _bodies(scene: Scene) -> dict[str, NDArray[np.void]]:
    """One message of each topic, to be repeated: the same for every log of a robot."""
    frame = np.array(scene.frame)
    return {
        "/tf": _transform(),
        "/viewer/pose": _pose(),
        "/viewer/desired": _pose(),
        "/viewer/winches": _winches(len(frame)),
        "/viewer/markers": _markers(frame, np.array(scene.platform)),
    }


def _markers(frame: Array, anchors: Array) -> NDArray[np.void]:
    body, points = Body().length("markers", len(_MARKED)), 2 * len(anchors)
    _marker(body, "frame", 0, BASE, _LINES, (_FRAME_WIDTH, 0.0, 0.0), 2 * len(_BOX), 0)
    # Flat markers cannot be seen from the side, so no extent is less than a beam's.
    extent = np.maximum(anchors.max(axis=0) - anchors.min(axis=0), _FRAME_WIDTH)
    _marker(body, "platform", 1, PLATFORM, _CUBE, tuple(extent), 0, 0)
    _marker(body, "cables", 2, BASE, _LINES, (_CABLE_WIDTH, 0.0, 0.0), points, points)
    template = body.template()
    corners = _corners(frame)
    template["frame.points"] = np.array([corners[end] for pair in _BOX for end in pair])
    return template


def _corners(frame: Array) -> Array:
    """(8, 3) m, of the box round the frame's anchors."""
    (x0, y0, z0), (x1, y1, z1) = frame.min(axis=0), frame.max(axis=0)
    ring = [(x1, y1), (x0, y1), (x0, y0), (x1, y0)]
    return np.array([(x, y, z) for z in (z1, z0) for x, y in ring])


def _marker(
    body: Body,
    name: str,
    number: int,
    frame: str,
    kind: int,
    scale: tuple[Any, ...],
    points: int,
    colours: int,
) -> None:
    """visualization_msgs/Marker with this many points and colours."""
    body.header(f"{name}.header", frame).text(f"{name}.ns", name)
    body.put(f"{name}.id", "<i4", value=number).put(f"{name}.type", "<i4", value=kind)
    body.put(f"{name}.action", "<i4").put(f"{name}.position", "<f8", 3)
    body.put(f"{name}.rotation", "<f8", 4, value=(0.0, 0.0, 0.0, 1.0))
    body.put(f"{name}.scale", "<f8", 3, value=scale)
    body.put(f"{name}.color", "<f4", 4, value=(0.5, 0.5, 0.5, 0.6))
    body.put(f"{name}.lifetime", "<i4", 2).put(f"{name}.locked", "u1")
    body.length(f"{name}.points", points)
    if points:
        body.put(f"{name}.points", "<f8", points, 3)
    body.length(f"{name}.colors", colours)
    if colours:
        body.put(f"{name}.colors", "<f4", colours, 4)
    body.text(f"{name}.texture_resource", "").header(f"{name}.texture", "")
    body.text(f"{name}.texture.format", "").length(f"{name}.texture.data", 0)
    body.length(f"{name}.uv", 0).text(f"{name}.text", "").text(f"{name}.mesh_resource", "")
    body.text(f"{name}.mesh.filename", "").length(f"{name}.mesh.data", 0)
    body.put(f"{name}.embedded", "u1")


def _matrices(quaternions: Array) -> Array:
    """Rotations (n, 3, 3) of unit quaternions (n, 4), w first."""
    w, x, y, z = quaternions.T
    columns = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(columns), -1, 0)
