"""The lab's door: requests by which its owner injects faults and looks at what it does.

A request is one JSON object, ``{"op": ..., ...}``, and so is its reply. That has ``"ok"``: true, or
false with ``"error"``, one line. `Door.request` works in any time and needs no socket.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Literal, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from tonus.config.faults import KINDS, FaultKind
from tonus.config.schema.base import Section
from tonus.config.schema.faults import ClearFaults, Fault
from tonus.config.schema.robot_faults import OfRobot
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.errors import LabError
from tonus.sim.ethercat import verbs
from tonus.sim.lab.engine import Lab

REQUEST_BYTES = 65536
_LINE = 500
"""Characters of an error; it may quote what came."""
Reply = dict[str, Any]
_SECOND_NS = 1_000_000_000
_OF_ROBOT = frozenset(
    get_args(model.model_fields["kind"].annotation)[0] for model in get_args(OfRobot)
)
_OF_DRIVES = frozenset({"drive_error", "drive_input"})
_OF_CELLS = frozenset({"cell_break"})


class _Inject(Section):
    op: Literal["inject"]
    fault: Fault


class _Clear(Section):
    op: Literal["clear"]
    channel: str | None = None


class _Get(Section):
    op: Literal["get"]


class _Kinds(Section):
    op: Literal["kinds"]


class _Ping(Section):
    op: Literal["ping"]


class Door:
    """Answers for one lab, at the lab's present: whoever asks has brought it there."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._verbs: dict[str, tuple[type[Section], Callable[[Any], Reply]]] = {
            "inject": (_Inject, lambda request: self._inject(request.fault)),
            "clear": (_Clear, self._clear),
            "get": (_Get, lambda _: self._get()),
            "kinds": (_Kinds, lambda _: {"kinds": self._kinds()}),
            "ping": (_Ping, lambda _: {}),
        }
        if lab.segments:
            self._verbs |= verbs.of(lab.segments, lab)

    def answer(self, datagram: bytes) -> bytes:
        """The reply to a request as it came; whatever the bytes are, there is one."""
        return json.dumps(self._read(datagram)).encode()

    def _read(self, datagram: bytes) -> Reply:
        if len(datagram) > REQUEST_BYTES:
            return refusal(f"the request is longer than {REQUEST_BYTES} bytes; send less")
        try:
            request = json.loads(datagram)
        except UnicodeDecodeError:
            return refusal("the request is not UTF-8; send one JSON object")
        except (ValueError, RecursionError) as error:
            return refusal(f"the request is not JSON: {error}; send one JSON object")
        return self.request(request)

    def request(self, request: object) -> Reply:
        """Carry out a request. ``time`` in the reply is the lab time in s at which it was done."""
        if not isinstance(request, dict):
            return refusal(f"a request is a JSON object, not {reprlib.repr(request)}")
        op = request.get("op")
        verb = self._verbs.get(op) if isinstance(op, str) else None
        if verb is None:
            known = ", ".join(self._verbs)
            there = f"there is no op {reprlib.repr(op)}" if "op" in request else "op is missing"
            return refusal(f"{there}; choose one of {known}")
        model, act = verb
        try:
            done = act(model.model_validate(request))
        except ValidationError as error:
            return refusal(_explain(error))
        except LabError as error:
            return refusal(str(error))
        return {"ok": True, "time": self._seconds(self._lab.now_ns), **done}

    def _seconds(self, at_ns: int) -> float:
        return (at_ns - self._lab.start_ns) / _SECOND_NS

    # -- verbs -----------------------------------------------------------------------------------

    def _inject(self, fault: Fault) -> Reply:
        """``at`` in the reply is the lab time in s at which the fault begins."""
        self._lab.inject(fault)
        return {"at": self._seconds(self._lab.now_ns + round(fault.at * _SECOND_NS))}

    def _clear(self, request: _Clear) -> Reply:
        return self._inject(ClearFaults(kind="clear", channel=request.channel))

    def _get(self) -> Reply:
        lab = self._lab
        return {
            "seed": lab.seed,
            "channels": lab.statistics()["channels"],
            "nodes": [self._node(*place) for place in lab.nodes],
            "segments": verbs.segments(lab.segments),
            "slaves": verbs.slaves(lab.segments),
            "faults": lab.faults(),
        }

    def _node(self, channel: str, number: int) -> Reply:
        node = self._lab.nodes[channel, number]
        device = node.device
        told: Reply = {
            "channel": channel,
            "node": number,
            "plugged": node.plugged,
            "nmt": node.state.name,
        }
        if isinstance(device, Cia402Drive):
            told |= {
                "device": f"axis {device.axis}",
                "state": device.state.name,
                "error": device.objects.number(0x603F, 0),
            }
        elif isinstance(device, ForceCell):
            register = device.objects.number(0x1001, 0)
            cells = " ".join(str(cell) for cell in device.cells)
            told |= {"device": f"cell {cells}", "state": None, "error": register}
        return told

    def _kinds(self) -> dict[str, Reply]:
        """Every kind with its fields, and where on this lab it can happen."""
        return {name: {**_TOLD[name], "where": self._where(kind)} for name, kind in KINDS.items()}

    def _where(self, kind: FaultKind) -> list[str]:
        lab = self._lab
        if kind.name in _OF_ROBOT:
            return lab.robot_places(kind.name, axis=kind.has("axis"), cell=kind.has("cell"))
        on_can, on_ethercat = verbs.possible(kind.name)
        if not kind.has("node"):
            return [*(lab.channels if on_can else ()), *(lab.segments if on_ethercat else ())]
        wanted: type[Any] = object
        if kind.name in _OF_DRIVES:
            wanted = Cia402Drive
        elif kind.name in _OF_CELLS:
            wanted = ForceCell
        places = [(*place, node.device) for place, node in lab.nodes.items() if on_can]
        if on_ethercat:
            for name, segment in lab.segments.items():
                places += [(name, slave.number, slave.device) for slave in segment.slaves]
        return [f"{name}/{number}" for name, number, device in places if isinstance(device, wanted)]


def refusal(line: str) -> Reply:
    """The reply to what cannot be done."""
    return {"ok": False, "error": " ".join(line.split())[:_LINE]}


def _explain(error: ValidationError) -> str:
    """The first broken rule of a request: field, rule, and what was found."""
    found = error.errors()
    # A misspelt field is also a missing one; its own name is the better answer.
    first = next((each for each in found if each["type"] == "extra_forbidden"), found[0])
    kind = first["type"]
    # pydantic puts the kind of a fault between "fault" and its field.
    place = ".".join(str(part) for part in first["loc"] if part not in KINDS)
    if kind == "missing":
        return f"{place} is missing; add it"
    if kind == "extra_forbidden":
        return f"{place} is not a field here; {_fields(first)}"
    if kind == "union_tag_invalid":
        tag = reprlib.repr(first["ctx"]["tag"])
        return f"{place}: there is no kind {tag}; choose one of {', '.join(KINDS)}"
    if kind == "union_tag_not_found":
        return f"{place} has no kind; choose one of {', '.join(KINDS)}"
    rule = first["msg"].removeprefix("Value error, ")
    return f"{place}: {rule[0].lower()}{rule[1:]}, not {reprlib.repr(first['input'])}"


def _fields(error: ErrorDetails) -> str:
    kind = next((KINDS[part] for part in error["loc"] if part in KINDS), None)
    if kind is None:
        return "remove it"
    return f"{kind.name} has {', '.join(field.name for field in kind.fields)}"


_TOLD: dict[str, Reply] = {
    name: {
        "about": kind.about,
        "fields": {
            field.name: {
                key: value
                for key, value in asdict(field).items()
                if key != "name" and value is not None
            }
            for field in kind.fields
        },
    }
    for name, kind in KINDS.items()
}
"""what is the same for every lab; made once, since a client may ask without end"""
