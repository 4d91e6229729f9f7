"""The verbs that a running daemon understands."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.runtime.states import Operator


@dataclass(frozen=True)
class Verb:
    """One thing to ask."""

    name: str
    about: str
    operator: Operator = Operator.NONE


VERBS: dict[str, Verb] = {
    verb.name: verb
    for verb in (
        Verb("status", "what the daemon does now; no event, everything else is one"),
        Verb("arm", "STANDBY to HOLD, through referencing and pretension", Operator.ARM),
        Verb("start", "play the scenario, or go on with it", Operator.START),
        Verb("hold", "pause the scenario where it is", Operator.HOLD),
        Verb("stop", "controlled stop, back to STANDBY", Operator.STOP),
        Verb("estop", "disable every drive in the same tick", Operator.ESTOP),
        Verb("reset", "leave FAULT once its cause is corrected", Operator.RESET),
        Verb("scenario", "choose what START plays, by `name`; in HOLD or disarmed"),
        Verb("set", "change a tunable parameter, by `key`, to `value`; in STANDBY, HOLD or ACTIVE"),
    )
}
