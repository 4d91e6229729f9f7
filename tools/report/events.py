"""The page docs/events.md: every event name, what it means, what is done about it, what to do.

python -m tonus.tools.report.events > docs/events.md
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

from tonus.drivers import events as drivers
from tonus.drivers.events import Meaning
from tonus.runtime import events as daemon
from tonus.runtime.safety import firewall
from tonus.runtime.states import Fault
from tonus.runtime.words import REMEDY, TEXT, reaction

_HEAD = """\
# Events

For everyone who reads a log, a report or the daemon's terminal: the meaning of every event name.

An event is a message on `/tonus/events` with time, tick, level, name, place and text. `tonus log
info FILE` and `tonus log report FILE` list them. The text of a fault or of a driver's event ends
with the reaction. Where the same event repeats at the same place, the log has the first, second,
fourth, eighth … occurrence; an event that lasts is logged once, at its beginning.

| group | place | |
|---|---|---|
| [daemon and recorder](#daemon-and-recorder) | the part, or empty | commands, states, recording |
| [faults](#faults) | axis or cell, with its bus address | what stops the robot |
| [drivers](#drivers) | channel and node, or slave | buses, devices, tracker |
| [firewall](#firewall) | the part | exceptions in code that runs beside control |

This page is printed from the code (`python -m tonus.tools.report.events`).
"""
_FAULTS = """\
A fault is the reason of a stop. Its event has the name of the fault in small letters. The first
fault since the last reset is an error; each one found during the stop is a warning.
[fmea.md](fmea.md) has causes, reaction times and tests.
"""
_DRIVERS = """\
When the bus is connected again, the CAN controller sends the frames it still holds, also torques
from old measurements. The master therefore drops waiting frames as soon as no node of the channel
has answered for longer than a measurement is fresh. python-can cannot do this on SocketCAN: there,
frames of at most that many ticks are sent when the bus is connected again, then torques of 0. A
SocketCAN controller also needs a restart time (`ip link set can0 type can restart-ms 100`), or it
stays bus-off.
"""
_FIREWALL = """\
Code that runs beside control in the tick (record, ring, keyframes, frame tap, reporter, events,
self-test, control socket, service notification, tracker input, commands) is called through one
firewall (`runtime/safety/firewall.py`). Tracebacks are written to the process' log after the run.
Inputs, commands, the emergency stop and the service notification are never switched off.
"""
_CONTROL = """\
For an exception in control itself the part is `control`, and the fault `CONTROL_FAILED` follows:
control is not called again, the passive fallback replaces it until no drum turns
(`operation.fallback`), then the drives are disabled and the run ends in FAULT with exit code 1.
"""


def faults() -> dict[str, Meaning]:
    """The events of the faults, with the reaction of an armed robot."""
    return {
        fault.name.lower(): Meaning(TEXT[fault], reaction(fault, armed=True), REMEDY[fault])
        for fault in Fault
        if fault is not Fault.NONE
    }


def every() -> dict[str, Meaning]:
    """All events, by name."""
    return daemon.EVENTS | faults() | drivers.EVENTS | firewall.EVENTS


def markdown() -> str:
    """The whole page."""
    parts = [_HEAD]
    parts += ["## Daemon and recorder\n", _table(daemon.EVENTS)]
    parts += ["## Faults\n", _FAULTS, _table(faults())]
    parts += ["## Drivers\n", _table(drivers.EVENTS), _DRIVERS]
    parts += ["## Firewall\n", _FIREWALL, _table(firewall.EVENTS), _CONTROL]
    return "\n".join(parts)


def _table(events: Mapping[str, Meaning]) -> str:
    rows = [
        f"| `{name}` | {each.meaning} | {each.reaction} | {each.remedy} |"
        for name, each in events.items()
    ]
    head = ["| event | meaning | reaction | what to do |", "|---|---|---|---|"]
    return "\n".join([*head, *rows]) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
