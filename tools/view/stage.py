"""What viser's client shows: a tree of nodes, told to every page that opens, and what changes.

The client is viser's, a file; what is told to it is made here, for the few kinds of node that a
robot is drawn with. viser's own server would do that too, but its library takes as long to load as
all the rest of a first picture, and has more behind its socket than a robot should have: tunnels
to the internet, files to upload. A test holds what is told here against what viser itself tells.

A message is a mapping of plain values and arrays; each has a key, under which a newer one takes the
place of what a page has not been sent yet.
"""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from tonus.tools.view.client import SPOKEN, Message, encoded

Colour = tuple[int, ...]
_Floats = Sequence[float] | NDArray[Any]

_NOT_TURNED, _NOT_MOVED = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
_Z_UP = (0.5, -0.5, 0.5, 0.5)
"""turns the client's world, whose y is up, so that z is up and both others face its camera"""
_AXES_LENGTH, _AXES_RADIUS, _ORIGIN = 0.5, 0.025, (236, 236, 0)
_PANEL = "viser-control-panel"
_PROTOCOL_ERROR = 1002
_DONE: Message = {"type": "ReplayDoneMessage"}
"""after what stands already, before what changes"""


class Node:
    """One thing in the picture. What is set to what it is already is not told again."""

    def __init__(
        self, stage: Stage, name: str, kind: str, props: Message, *, between: bool = False
    ) -> None:
        """``between``: only there because of what is below it."""
        self._stage, self._name, self._props = stage, name, props
        self._visible = True
        self._pose: dict[str, tuple[float, ...]] = {
            "position": _NOT_MOVED,
            "wxyz": _NOT_TURNED,
        }
        made = {"name": name, "owner": "", "virtual": between, "props": dict(props), "type": kind}
        stage.tell(f"{name}:made", made)
        self._tell("SetSceneNodeVisibilityMessage", visible=True)

    def _tell(self, kind: str, **what: Any) -> None:
        message = {"name": self._name, "owner": "", **what, "type": kind}
        self._stage.tell(f"{self._name}:{kind}", message)

    @property
    def visible(self) -> bool:
        """With all that is below it in the tree."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible != self._visible:
            self._visible = visible
            self._tell("SetSceneNodeVisibilityMessage", visible=visible)

    @property
    def position(self) -> _Floats:
        """(3,) m, in its parent's frame."""
        return self._pose["position"]

    @position.setter
    def position(self, position: _Floats) -> None:
        self._move("position", position, "SetPositionMessage")

    @property
    def wxyz(self) -> _Floats:
        """(4,), a unit quaternion, w first."""
        return self._pose["wxyz"]

    @wxyz.setter
    def wxyz(self, wxyz: _Floats) -> None:
        self._move("wxyz", wxyz, "SetOrientationMessage")

    def _move(self, what: str, given: _Floats, kind: str) -> None:
        values = tuple(map(float, given))
        if values != self._pose[what]:
            self._pose[what] = values
            self._tell(kind, **{what: values})

    @property
    def points(self) -> NDArray[np.float32]:
        """(k, 2, 3) m: the ends of lines or arrows."""
        points: NDArray[np.float32] = self._props["points"]
        return points

    @points.setter
    def points(self, points: ArrayLike) -> None:
        self._change("points", np.array(points, np.float32))

    @property
    def colors(self) -> NDArray[np.uint8]:
        """(k, 2, 3) of the ends of lines, or (3,) of all."""
        colors: NDArray[np.uint8] = self._props["colors"]
        return colors

    @colors.setter
    def colors(self, colors: ArrayLike) -> None:
        self._change("colors", np.array(colors, np.uint8))

    def _change(self, prop: str, value: NDArray[Any]) -> None:
        if not np.array_equal(value, self._props[prop]):
            self._props[prop] = value
            message = {"name": self._name, "updates": {prop: value}, "owner": ""}
            self._stage.tell(f"{self._name}:{prop}", message | {"type": "SceneNodeUpdateMessage"})


class _Page:
    """One that shows the stage."""

    def __init__(self, told: dict[str, Message]) -> None:
        self.waiting = told | {"": _DONE}
        """by their keys, in the order in which they are sent"""
        self.wake = asyncio.Event()
        self.loop = asyncio.get_running_loop()


class Stage:
    """All nodes; of one thread, and `serve` of another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._told: dict[str, Message] = {}
        """what makes the stage as it stands, by key, in order"""
        self._surroundings: dict[str, Message] = {}
        self._nodes: dict[str, Node] = {}
        self._pages: list[_Page] = []
        self._open = 0
        run = secrets.token_hex(4)
        panel = {"uuid": _PANEL, "collapsed": True, "counter": 1, "run_id": run}
        theme: Message = {
            "titlebar_content": None,
            "control_layout": "floating",
            "control_width": "medium",
        }
        theme |= {"show_logo": False, "show_share_button": False, "dark_mode": False}
        for message in (
            {"name": "", "wxyz": _Z_UP, "owner": "", "type": "SetOrientationMessage"},
            # Shadows cost most of the time of a browser that draws without a graphics processor.
            {"enabled": True, "cast_shadow": False, "type": "EnableLightsMessage"},
            {**theme, "colors": None, "type": "ThemeConfigurationMessage"},
            {**panel, "type": "GuiSetPanelCollapsedMessage"},
        ):
            self.tell(str(message["type"]), message)
        self._surroundings = dict(self._told)

    # -- what is shown ---------------------------------------------------------------------------

    def look(self, position: _Floats, at: _Floats) -> None:
        """Where a page looks from when it opens, and at what."""
        for what, given in (("position", position), ("look_at", at)):
            kind = "SetCameraPositionMessage" if what == "position" else "SetCameraLookAtMessage"
            self.tell(kind, {what: tuple(map(float, given)), "initial": True, "type": kind})

    def clear(self) -> None:
        """Take every node away; their names are not to be used again."""
        with self.atomic():
            for name in self._nodes:
                self.tell(
                    f"{name}:made", {"name": name, "owner": "", "type": "RemoveSceneNodeMessage"}
                )
        self._nodes.clear()
        with self._lock:
            self._told = dict(self._surroundings)

    def add_frame(
        self,
        name: str,
        *,
        show_axes: bool = True,
        axes_length: float = _AXES_LENGTH,
        axes_radius: float = _AXES_RADIUS,
        position: _Floats = _NOT_MOVED,
        visible: bool = True,
    ) -> Node:
        """What holds others, with or without its axes."""
        props = _frame(show_axes=show_axes, length=axes_length, radius=axes_radius)
        return self._add(name, "FrameMessage", props, position=position, visible=visible)

    def add_mesh_simple(
        self,
        name: str,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        color: Colour,
        opacity: float | None = None,
        flat_shading: bool = False,
        side: str = "front",
    ) -> Node:
        """Triangles (f, 3) between vertices (v, 3)."""
        props = {"vertices": np.array(vertices, np.float32), "faces": np.array(faces, np.uint32)}
        return self._add(
            name, "MeshMessage", props | _surface(color, opacity, side, flat=flat_shading)
        )

    def add_box(
        self,
        name: str,
        color: Colour,
        dimensions: _Floats,
        *,
        opacity: float | None = None,
        wxyz: _Floats = _NOT_TURNED,
        position: _Floats = _NOT_MOVED,
    ) -> Node:
        """About its middle."""
        props = {"dimensions": tuple(map(float, dimensions))}
        props |= _surface(color, opacity, "front", flat=True)
        return self._add(name, "BoxMessage", props, wxyz=wxyz, position=position)

    def add_cylinder(self, name: str, radius: float, height: float, color: Colour) -> Node:
        """Along z, about its middle."""
        props = {"radius": radius, "height": height, "radial_segments": 32}
        return self._add(
            name, "CylinderMessage", props | _surface(color, None, "front", flat=False)
        )

    def add_line_segments(
        self,
        name: str,
        points: ArrayLike,
        colors: ArrayLike,
        *,
        thickness: float,
        visible: bool = True,
    ) -> Node:
        """Lines between points (k, 2, 3), ``thickness`` in m."""
        props = _ends(points, colors)
        props |= {"thickness": thickness, "thickness_units": "world", "scale": 1.0}
        return self._add(name, "LineSegmentsMessage", props, visible=visible)

    def add_arrows(
        self,
        name: str,
        points: ArrayLike,
        colors: ArrayLike,
        *,
        shaft_radius: float,
        head_radius: float,
        head_length: float,
        visible: bool = True,
    ) -> Node:
        """Arrows between points (k, 2, 3)."""
        props = _ends(points, colors) | {"shaft_radius": shaft_radius, "scale": 1.0}
        props |= {"head_radius": head_radius, "head_length": head_length}
        return self._add(name, "ArrowMessage", props, visible=visible)

    def _add(
        self,
        name: str,
        kind: str,
        props: Message,
        *,
        wxyz: _Floats = _NOT_TURNED,
        position: _Floats = _NOT_MOVED,
        visible: bool = True,
        between: bool = False,
    ) -> Node:
        above = name.rpartition("/")[0]
        if above and above not in self._nodes:
            self._add(above, "FrameMessage", _frame(show_axes=False), between=True)
        node = self._nodes[name] = Node(self, name, kind, props, between=between)
        node.wxyz, node.position, node.visible = wxyz, position, visible
        return node

    # -- how it is told --------------------------------------------------------------------------

    @contextmanager
    def atomic(self) -> Iterator[None]:
        """What is told in this block is shown in one picture."""
        with self._lock:
            self._open += 1
        try:
            yield
        finally:
            with self._lock:
                self._open -= 1
            self._wake()

    def tell(self, key: str, message: Message) -> None:
        """Every page, now or when it opens; in place of what has the same key."""
        with self._lock:
            for told in (self._told, *(page.waiting for page in self._pages)):
                told.pop(key, None)
                told[key] = message
            waits = bool(self._open) or not self._pages
        if not waits:
            self._wake()

    def _wake(self) -> None:
        with self._lock:
            pages = tuple(self._pages)
        for page in pages:
            with suppress(RuntimeError):  # its loop has ended
                page.loop.call_soon_threadsafe(page.wake.set)

    async def serve(self, connection: ServerConnection) -> None:
        """One page, to its end. Whatever it says, of its camera for example, is not even read."""
        if not (connection.subprotocol or "").startswith(SPOKEN):
            await connection.close(_PROTOCOL_ERROR, "a client of another version")
            return
        with self._lock:
            page = _Page(self._told)
            self._pages.append(page)
        page.wake.set()
        sending = asyncio.create_task(self._send(page, connection))
        try:
            async for _ in connection:
                pass
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._pages.remove(page)
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _send(self, page: _Page, connection: ServerConnection) -> None:
        """As fast as the page reads; what it is too slow for is replaced by what is newer."""
        while True:
            await page.wake.wait()
            page.wake.clear()
            with self._lock:
                if self._open:
                    continue  # woken again at the end of the block
                messages = tuple(page.waiting.values())
                page.waiting.clear()
            if messages:
                await connection.send(encoded(messages))


def _frame(
    *, show_axes: bool, length: float = _AXES_LENGTH, radius: float = _AXES_RADIUS
) -> Message:
    props = {"show_axes": show_axes, "axes_length": length, "axes_radius": radius, "scale": 1.0}
    return props | {"origin_radius": 2 * radius, "origin_color": _ORIGIN}


def _surface(color: Colour, opacity: float | None, side: str, *, flat: bool) -> Message:
    shown = {"color": color, "opacity": opacity, "flat_shading": flat, "side": side}
    fixed = {"wireframe": False, "material": "standard", "scale": 1.0}
    return shown | fixed | {"cast_shadow": True, "receive_shadow": True}


def _ends(points: ArrayLike, colors: ArrayLike) -> Message:
    return {"points": np.array(points, np.float32), "colors": np.array(colors, np.uint8)}
