"""The state machine in docs/states.md, drawn and told from its own table.

python -m tonus.tools.report.states > docs/states.md
"""

from __future__ import annotations

import sys

from tonus.config.schema.safety import Stop
from tonus.runtime.safety.sequence import FEWEST
from tonus.runtime.states import (
    ARMED,
    MEANING,
    MOVES,
    NEXT,
    TRANSITIONS,
    Event,
    Fault,
    Operator,
    State,
    StopMode,
)
from tonus.runtime.words import STOP_TEXT, TEXT, reaction

_HEAD = """# The state machine

For operators and developers: every state, what each event does in it, and how the robot stops.

One table (`runtime/states.py`) defines what every event does in every state; this page is printed
from it (`python -m tonus.tools.report.states`). A tick handles at most one event; a fault comes
before a command. *Armed* states, in which drives are enabled, have a thick border.
"""
_FEWEST_DOUBTED = Stop.model_fields["fewest_doubted"].default
_ASSUMES = {
    StopMode.ON_PATH: "all cables, a known pose",
    StopMode.DESCENT: f"{FEWEST} cables, {_FEWEST_DOUBTED} after a contradiction; a known pose",
    StopMode.PASSIVE: "each drum's own encoder; also before the cables are referenced",
}


def _modes() -> str:
    return "\n".join(
        f"| {mode.name} | {_ASSUMES[mode]} | {STOP_TEXT[mode]} |"
        for mode in StopMode
        if mode is not StopMode.NONE
    )


_STOP = f"""## The controlled stop

A cable robot must not release all cables at once while any drive answers: the platform would
drop, or the load would throw it. SAFE_STOP has three modes (`state.stop_mode` in the log, event
`stop_mode`). A tick uses the first one whose assumptions hold. A stop never returns to an earlier
one.

| mode | assumes | what |
|---|---|---|
{_modes()}

Faults of drives and cells are detected in every state but FAULT, also in a stop. The motion of each
drum is compared with its torque in every armed state. Bounds and contradictions between cables are
checked while the platform moves, bounds also in a descent. The first fault since the last reset is
the reason of the stop. Each later one is an event; it may exclude another cable (`state.failed`)
or change the mode.

### On the path

The times are in `control.sequence`.

| step | takes | what |
|---|---|---|
| slow down | `stop_s` | the reference's velocity goes to zero along the platform's way |
| wait | at most `hold_s` | while the load exceeds `release_load` and no contact limit was met |
| lower | `lower_s`, from far away longer | down to the cradle, minimum jerk |
| release | `stop_s` | stiffness from K0 to K_min, tensions to the referencing level, together |
| disable | at once | every drive, while its cable still has that tension |

A stop because of contact uses K_min from its first tick. A platform that is at most
`control.stop.landed` above its cradle, and is then held aside by `load_free` more than before, is
held by the cradle itself, and the path leads elsewhere: the stop becomes passive.

### Descent

A cable is excluded when its drive or cell is lost or defective, or when its length or tension
contradicts the others. Its tension reference is zero. The active cables carry the weight and damp
every motion; no position is held, and the platform comes down. The values are in `control.stop`.

- The remaining tension of an excluded cable counts as a load. Its drum damps by itself as in a
  passive stop if encoder, motor and cell are sound and the cable is not torn; on a drum that turns
  freely the tension falls to zero within a few `release_s`.
- The drum of a cable below half of `taut_tension` follows the platform and reels in `take_up_speed`
  faster, until the cable pulls.
- Each drum brakes above the speeds `reel_in` and `reel_out`, and adds no more energy than its
  `tank` holds.
- The tension loop has the gain `proportional` while a loss throws the platform, and `calm` later
  (`throw_s`), or once more than one cable is lost.
- A descent takes as long as a stop on the path, without the wait. Then, if the platform is no more
  than `landed` above the cradle, whatever load is measured, each drum damps by itself while its
  tension goes to zero within `stop_s`, and the drives are disabled when all drums are at rest, at
  the latest `landing_s` later. If it is higher, the stop becomes passive when all
  drums are at rest, at the latest after another `landing_s`. It also becomes passive when the
  platform rises by `rise` later than `settle_s`: a measurement that it relies on is then wrong.
  And, once several cables are lost, when its plans have missed more than the share `unsupported`
  of the weight for `unsupported_s`.

### Passive

It uses no pose, no cell and no plan. Each drum with a usable encoder gets the force
`passive_tension` minus `passive_damping` times its own rate (`passive_damping_in` when it reels
in), at most `passive_force`, and is braked
with `reel_damping` beyond `passive_speed`. When all drums have been at rest for `rest_s`, or slower
than that for as long as lowering takes on the path, and after `passive_s` in any case, the tension
goes to zero within `stop_s`; the damping stays, and the platform comes down against it. Every
drive is disabled when all drums have then been at rest for `rest_s`, at the latest after
`passive_s` and `landing_s`. A stop becomes passive when a computed value is not a number, when the
cables contradict each other and none stands out, when too few are left, or when a descent does not
come down. Before the cables are referenced it releases their tension within `stop_s`. After an
exception in control the same law acts, with the times in `operation.fallback`; the run ends.

### Emergency stop and brakes

An emergency stop disables every drive in the same tick, without any of these modes. The daemon
commands no brakes: an EPOS4 with a holding brake applies it when it is disabled (0x3158 has the
brake's times). The paper's robot has none.

## Signals

| signal | what the daemon does |
|---|---|
| SIGTERM, SIGINT | controlled stop, then the run ends |
| the same again | emergency stop, then the run ends |
| one of them while the bus is brought up | the bring-up and the run end at once |
| SIGHUP with `--serve` | an event in the log; the configuration is read at the start only |
| SIGHUP without | as SIGTERM: the terminal was closed |
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
    return "\n".join([*rows, "", "Any other event leaves the state unchanged."]) + "\n"


def _commands() -> str:
    commands = [command for command in Operator if command is not Operator.NONE]
    rows = [
        "## Commands",
        "",
        "The state that a command leads to; an empty cell is a refusal.",
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
