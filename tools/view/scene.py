"""The robot in three dimensions, from its configuration: any number of cables, any frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import ARMED
from tonus.tools.view.colours import GHOST, Tint, of_tension
from tonus.tools.view.hull import hull
from tonus.tools.view.moment import Array, Rows, Samples
from tonus.tools.view.settings import settings
from tonus.tools.view.shape import Shape
from tonus.tools.view.stage import Node, Stage

_CABLE, _BEAM, _LINE = 0.009, 0.012, 0.005
"""m, as drawn"""
_WINCH_LENGTH = 0.05
_STEP, _TURN_STEP, _TENSION_STEP, _FORCE_STEP = 1e-4, 0.01, 0.5, 0.3
"""m, rad, N and N: less is not seen"""
_LEAST_FORCE = 0.5
"""N, below which no arrow is drawn"""
_NEVER = np.empty(())
"""what has not been drawn yet: of no shape that anything has"""
_APART = 0.002
"""m between truth and estimate, from which on both are drawn"""
_PHANTOM = 0.35
"""m, side of the phantom as drawn: its model is a plane"""


class RobotScene:
    """One robot on a stage, under ``name``; of several the later ones are ``tint``ed."""

    def __init__(
        self,
        stage: Stage,
        shape: Shape,
        *,
        name: str = "/robot",
        tint: Tint | None = None,
    ) -> None:
        self._stage, self._shape, self._tint = stage, shape, tint
        self._exits, self._anchors = shape.frame, shape.platform
        n = len(self._exits)
        if tint is None:
            self._surroundings(stage, name)
        colour = (70, 110, 160) if tint is None else tint.colour
        self._platform = stage.add_frame(f"{name}/platform", show_axes=tint is None, **_AXES)
        _body(stage, f"{name}/platform/body", self._anchors, colour, 0.85)
        self._ghost = stage.add_frame(f"{name}/reference", show_axes=False, visible=False)
        _body(stage, f"{name}/reference/body", self._anchors, GHOST, 0.25)
        self._true = stage.add_frame(f"{name}/truth", show_axes=False, visible=False)
        _body(stage, f"{name}/truth/body", self._anchors, (60, 160, 90), 0.3)
        ends = np.stack([self._exits, self._exits + 1e-3], axis=1)
        self._cables = stage.add_line_segments(
            f"{name}/cables", ends, np.full((n, 2, 3), 160, np.uint8), thickness=_CABLE
        )
        self._winches = [
            _winch(stage, f"{name}/winches/{number}", place, radius)
            for number, (place, radius) in enumerate(
                zip(self._exits, shape.drum_radius, strict=True)
            )
        ]
        self._forces = {
            kind: stage.add_arrows(
                f"{name}/forces/{kind}",
                np.zeros((1, 2, 3)),
                colour,
                shaft_radius=0.006,
                head_radius=0.016,
                head_length=0.04,
                visible=False,
            )
            for kind, colour in (("external", (213, 94, 0)), ("contact", (204, 121, 167)))
        }
        self._paths = {
            part: stage.add_line_segments(
                f"{name}/path/{part}", np.zeros((1, 2, 3)), colour, thickness=_LINE, visible=False
            )
            for part, colour in (("behind", (90, 90, 90)), ("ahead", GHOST))
        }
        self._behind: list[Array] = []
        self._drawn: dict[str, Array] = {}
        phantom = shape.phantom
        # The contact cell reports one number; only a lab's scenario tells its direction.
        self._normal = np.zeros(3) if phantom is None else _unit(np.array(phantom.normal))

    def _surroundings(self, stage: Stage, name: str) -> None:
        """What does not move."""
        low, high = self._exits.min(axis=0), self._exits.max(axis=0)
        stage.add_line_segments(f"{name}/frame", _box(low, high), (110, 110, 115), thickness=_BEAM)
        corners = self._shape.workspace
        stage.add_line_segments(
            f"{name}/workspace",
            _box(corners[:, 0], corners[:, 1]),
            (150, 170, 200),
            thickness=0.003,
        )
        lowest = self._anchors[:, 2].min()
        rest = self._shape.rest + np.array((0.0, 0.0, lowest - 0.01))
        across = self._anchors[:, :2].max(axis=0) - self._anchors[:, :2].min(axis=0)
        if self._shape.in_lab:
            stage.add_box(
                f"{name}/cradle", (130, 120, 105), (across[0], across[1], 0.02), position=rest
            )
        phantom = self._shape.phantom
        if phantom is not None:
            normal = _unit(np.array(phantom.normal))
            stage.add_box(
                f"{name}/phantom",
                (204, 121, 167),
                (_PHANTOM, _PHANTOM, 0.01),
                opacity=0.4,
                wxyz=_from_z(normal),
                position=np.array(phantom.point),
            )

    def show(self, newest: Rows, truth: Rows, samples: Samples, *, jumped: bool) -> None:
        """Put everything where it is in the record (1,); of a lab with the truth (1,)."""
        if not len(newest):
            return
        record = newest[0]
        pose, tension = record["pose"], record["tension"]["measured"]
        known = bool((pose["quaternion"] != 0.0).any())
        with self._stage.atomic():
            self._platform.visible = known
            armed = int(record["state"]["state"]) in ARMED
            self._ghost.visible = known and armed and self._tint is None
            if known:
                self._show_pose(pose, tension)
            self._show_winches(record["drives"]["angle"])
            self._show_forces(record, pose)
            self._show_truth(truth, pose["position"])
            self._show_behind(samples, jumped=jumped)

    def _show_pose(self, pose: Any, tension: Array) -> None:
        position = pose["position"]
        turned = rotation(pose["quaternion"])
        ends = position + self._anchors @ turned.T
        if self._moved("pose", ends, _STEP):
            self._platform.wxyz, self._platform.position = pose["quaternion"], position
            self._cables.points = np.stack([self._exits, ends], axis=1).astype(np.float32)
        if self._moved("tension", tension, _TENSION_STEP):
            colours = of_tension(tension, self._shape.levels)
            if self._tint is not None:
                colours = self._tint.over(colours)
            self._cables.colors = np.repeat(_linear(colours)[:, None], 2, axis=1)
        if self._moved("reference", pose["desired_position"], _STEP):
            self._ghost.position = pose["desired_position"]

    def _moved(self, what: str, values: Array, step: float) -> bool:
        """Whether these have changed visibly since they were last drawn: a browser draws anew for
        whatever is sent."""
        before = self._drawn.get(what, _NEVER)
        same = before.shape == values.shape
        if same and float(np.abs(values - before).max(initial=0.0)) < step:
            return False
        self._drawn[what] = np.array(values)
        return True

    def _show_winches(self, angles: Array) -> None:
        if self._moved("winches", angles, _TURN_STEP):
            for winch, angle in zip(self._winches, angles, strict=True):
                winch.wxyz = (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2))

    def _show_forces(self, record: Any, pose: Any) -> None:
        force = np.array(record["wrench"]["external"][:3])
        contact = float(record["wrench"]["contact"]) * self._normal
        for kind, value in (("external", force), ("contact", contact)):
            strong = bool(np.linalg.norm(value) > _LEAST_FORCE) and self._tint is None
            arrow = self._forces[kind]
            arrow.visible = strong
            if strong and self._moved(kind, np.concatenate((pose["position"], value)), _FORCE_STEP):
                start = pose["position"]
                end = start + settings().force_scale * value
                arrow.points = np.array([[start, end]], np.float32)

    def _show_truth(self, truth: Rows, position: Array) -> None:
        """Of a lab, where the estimate is visibly elsewhere."""
        there = self._tint is None and bool(len(truth)) and bool(truth["quaternion"].any())
        far = there and bool(np.linalg.norm(truth["position"][0] - position) > _APART)
        self._true.visible = far
        if far and self._moved("truth", truth["position"][0], _STEP):
            self._true.position = truth["position"][0]
            self._true.wxyz = truth["quaternion"][0]

    def _show_behind(self, samples: Samples, *, jumped: bool) -> None:
        """The reference's path, as far as it has been followed."""
        if jumped:
            self._behind.clear()
        if len(samples):
            self._behind.append(samples.rows["pose"]["desired_position"].copy())
        reach = int(settings().path_s * settings().sample_hz)
        points = np.concatenate(self._behind)[-reach:] if self._behind else np.empty((0, 3))
        self._behind = [points]
        extent = [points.min(axis=0), points.max(axis=0)] if len(points) else [np.zeros(3)] * 2
        if self._moved(
            "behind", np.concatenate([*extent, points[-1] if len(points) else extent[0]]), _STEP
        ):
            _draw(self._paths["behind"], points)

    def show_ahead(self, points: Array) -> None:
        """The reference's path to come (n, 3)."""
        if self._moved("ahead", points, _STEP):
            _draw(self._paths["ahead"], points)


_AXES: dict[str, Any] = {"axes_length": 0.12, "axes_radius": 0.004}


def rotation(quaternion: Array) -> Array:
    """(3, 3) of a unit quaternion (4,), w first."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def _linear(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The client takes the colours of a line's ends as linear ones, and those of all else as
    sRGB."""
    linear: NDArray[np.uint8] = (255.0 * (colours / 255.0) ** 2.2).astype(np.uint8)
    return linear


def _draw(node: Node, points: Array) -> None:
    """A polyline (n, 3), where it goes anywhere."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1) if len(points) > 1 else np.empty(0)
    moving = np.flatnonzero(steps > 1e-5)
    node.visible = bool(len(moving))
    if len(moving):
        node.points = np.stack([points[moving], points[moving + 1]], axis=1).astype(np.float32)


def _body(stage: Stage, name: str, anchors: Array, colour: tuple[int, ...], opacity: float) -> None:
    """The hull of the platform's anchors; a box round them where they lie in a plane."""
    faces = hull(anchors)
    if not len(faces):
        low, high = anchors.min(axis=0), anchors.max(axis=0)
        extent = np.maximum(high - low, 0.02)
        stage.add_box(name, colour, tuple(extent), opacity=opacity, position=(low + high) / 2)
        return
    stage.add_mesh_simple(
        name,
        anchors.astype(np.float32),
        faces,
        color=colour,
        opacity=opacity,
        flat_shading=True,
        side="double",
    )


def _winch(stage: Stage, name: str, place: Array, radius: float) -> Node:
    """A drum with a spoke, so that one sees it turn."""
    drum = stage.add_frame(name, show_axes=False, position=place)
    shown = max(float(radius), 0.02)
    stage.add_cylinder(f"{name}/drum", shown, _WINCH_LENGTH, (95, 95, 100))
    stage.add_box(f"{name}/spoke", (230, 230, 230), (2.2 * shown, 0.006, _WINCH_LENGTH * 1.05))
    return drum


def _box(low: Array, high: Array) -> Array:
    """The twelve edges (12, 2, 3) of a box."""
    corners = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])
    pairs = [(i, i | 1 << k) for k in range(3) for i in range(8) if not i >> k & 1]
    return np.array([[corners[a], corners[b]] for a, b in pairs], np.float32)


def _from_z(normal: Array) -> Array:
    """The quaternion (4,) that turns z into ``normal``."""
    axis = np.cross([0.0, 0.0, 1.0], normal)
    quaternion = np.array([1.0 + normal[2], *axis])
    length = np.linalg.norm(quaternion)
    return quaternion / length if length > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])
