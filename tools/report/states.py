"""The state machine in docs/states.md, drawn and told from its own table.

python -m tools.report.states > docs/states.md
"""

from __future__ import annotations

import sys

from runtime.states import ARMED, MEANING, MOVES, NEXT, TRANSITIONS, Event, Fault, Operator, State
from runtime.words import TEXT, reaction

_HEAD = """# The state machine

One table (`runtime/states.py`) says what every event does in every state; this page is printed
from it (`python -m tools.report.states`). At most one event a tick is followed, a fault before a
command. *Armed* states, in which drives are enabled, have a thick border.
"""
_STOP = """## The controlled stop

A cable robot must not let go of all its cables at once while anything answers: the platform would
drop, or be thrown by the load. SAFE_STOP takes these steps; the times are in `control.sequence`.

| step | takes | what |
|---|---|---|
| slow down | `stop_s` | the reference's velocity goes to zero along the platform's way |
| wait | at most `hold_s` | while more than `release_load` pushes and all cables are there |
| lower | `lower_s`, from far away longer | down to the cradle, minimum jerk |
| let down | `stop_s` | stiffness from K0 to K_min, tensions to the referencing level, together |
| disable | at once | every drive, while its cable still holds that little |

A stop because of contact is at K_min from its first tick on, and one without all eight cables
brings the platform down by weight and damping. Brakes are the drives' own affair: an EPOS4 wired to
a holding brake applies it itself when it is disabled (0x3158 holds the brake's times); the daemon
commands none, and the paper's robot has none. An emergency stop, and a computed value that is not a
number, skip all this: every drive is disabled in that tick.

## Signals

| signal | what the daemon does |
|---|---|
| SIGTERM, SIGINT | controlled stop, then it ends |
| the same again | emergency stop, then it ends |
| one of them while the bus is brought up | the bring-up and the run end at once |
| SIGHUP with `--serve` | noted in the log; the configuration is read at the start only |
| SIGHUP without | as SIGTERM: the terminal is gone |
| SIGKILL | nothing; the drives' heartbeat consumers stop them ([fmea.md](fmea.md)) |
"""


def markdown() -> str:
    """The whole page."""
    parts = [_HEAD, _drawn(), _states(), _moves(), _commands(), _faults(), _STOP]
    return "\n".join(parts)


def _drawn() -> str:
    rows = ["```mermaid", "stateDiagram-v2", "    [*] --> OFF"]
    ways: dict[tuple[State, State], list[str]] = {}
    for (state, event), move in MOVES.items():
        if event is not Event.ESTOP:
            ways.setdefault((state, move.to), []).append(event.name)
    rows += [
        f"    {state.name} --> {to.name}: {', '.join(names)}" for (state, to), names in ways.items()
    ]
    rows += [
        "    note right of FAULT: ESTOP leads here from every state",
        "    classDef armed stroke-width:4px",
        f"    class {', '.join(state.name for state in State if state in ARMED)} armed",
        "```",
        "",
    ]
    return "\n".join(rows)


def _states() -> str:
    rows = ["## States", "", "| state | | what an operator may do |", "|---|---|---|"]
    rows += [f"| {state.name} | {MEANING[state]} | {NEXT[state]} |" for state in State]
    return "\n".join(rows) + "\n"


def _moves() -> str:
    rows = ["## Transitions", "", "| in | on | to | because |", "|---|---|---|---|"]
    rows += [
        f"| {state.name} | {event.name} | {move.to.name} | {move.reason} |"
        for (state, event), move in MOVES.items()
    ]
    return "\n".join([*rows, "", "Any other event leaves a state as it is."]) + "\n"


def _commands() -> str:
    commands = [command for command in Operator if command is not Operator.NONE]
    rows = [
        "## Commands",
        "",
        "Where a command leads; an empty place is a refusal.",
        "",
        f"| | {' | '.join(command.name.lower() for command in commands)} |",
        f"|---|{'---|' * len(commands)}",
    ]
    rows += [
        f"| {state.name} | {' | '.join(_led(state, each) for each in commands)} |"
        for state in State
    ]
    return "\n".join([*rows, "", "`estop` is never refused, also in FAULT."]) + "\n"


def _led(state: State, command: Operator) -> str:
    to = TRANSITIONS[state, Event(command)]
    return "" if to is state and command is not Operator.ESTOP else to.name


def _faults() -> str:
    rows = ["## Faults", "", "| fault | | while armed | disarmed |", "|---|---|---|---|"]
    rows += [
        f"| {fault.name} | {TEXT[fault]} | {reaction(fault, armed=True)} "
        f"| {reaction(fault, armed=False)} |"
        for fault in Fault
        if fault is not Fault.NONE
    ]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
