"""What a page says of a moment: state, envelope, fault and its remedy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tonus.runtime.recording.payloads import Level
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import MEANING, NEXT, Fault, State, StopMode
from tonus.runtime.words import REMEDY, STOP_TEXT, TEXT, describe
from tonus.tools.view.moment import Happening, Rows

if TYPE_CHECKING:
    from tonus.config.schema.root import Config


def state_of(config: Config | None, newest: Rows) -> dict[str, Any]:
    """Of a record (1,), or (0,) before the first; without a configuration a fault has no place."""
    if not len(newest):
        return {"state": "", "meaning": "no record yet", "next": "", "fault": None}
    record = newest[0]
    told, envelope = record["state"], record["envelope"]
    state, fault = _known(State, told["state"]), _known(Fault, told["fault"])
    mode = _known(StopMode, told["stop_mode"])
    return {
        "state": _name(state, told["state"]),
        "meaning": MEANING[state] if state is not None else "",
        "next": NEXT[state] if state is not None else "",
        "stop": STOP_TEXT.get(mode, "") if mode is not None else "",
        "elapsed": round(float(told["elapsed"]), 1),
        "fault": _fault(config, fault, int(told["fault_where"])),
        "grade": _name(_known(Grade, envelope["grade"]), envelope["grade"]),
        "bound": _name(_known(Bound, envelope["bound"]), envelope["bound"]),
        "tension": [round(float(each), 1) for each in record["tension"]["measured"]],
        "k_eq": round(float(record["stiffness"]["k_eq"]), 0),
        "contact": round(float(record["wrench"]["contact"]), 2),
        "position": [round(1e3 * float(each), 1) for each in record["pose"]["position"]],
        "tick": int(record["timing"]["tick"]),
        "missed": [int(record["timing"]["missed_own"]), int(record["timing"]["missed_host"])],
        "failed": [int(each) for each in record["state"]["failed"].nonzero()[0]],
    }


def happening(run: int, each: Happening) -> dict[str, Any]:
    """An event of one run, by its number."""
    level = _known(Level, each.level)
    name = each.name.lower()
    return {
        "run": run,
        "t": round(each.time_s, 3),
        "level": level.name if level is not None else str(each.level),
        "name": each.name,
        "where": each.where,
        "text": each.text,
        "remedy": REMEDY.get(Fault[name.upper()], "") if name.upper() in Fault.__members__ else "",
    }


def _fault(config: Config | None, fault: Fault | None, where: int) -> dict[str, str] | None:
    if fault is None or fault is Fault.NONE:
        return None
    text = TEXT[fault] if config is None else describe(config, fault, where)
    return {"text": text, "remedy": REMEDY[fault]}


def _known(kind: Any, value: Any) -> Any:
    """None for a number that this version does not know, as another version's log may hold."""
    try:
        return kind(int(value))
    except ValueError:
        return None


def _name(known: Any, value: Any) -> str:
    return str(known.name) if known is not None else str(int(value))
