"""How the daemon is operated: its control socket, and what must be in order before it arms.

A key that is left out has the value that `config/operation.yaml` states.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Count, NonNegative, Positive, Section

Mode = Annotated[str, Field(pattern=r"^0[0-7]{3}$")]
Name = Annotated[str, Field(min_length=1)]


class ControlSocket(Section):
    """Who may speak to the daemon, how much, and how fast."""

    path: Name = "tonus.sock"
    """in the runtime directory, unless absolute"""
    mode: Mode = "0600"
    """file mode of the socket: who may connect at all"""
    group: Name | None = None
    """group that the socket's file is given to; null: the daemon's own"""
    users: tuple[Name, ...] = ()
    """may send commands, beside root and the daemon's own user"""
    groups: tuple[Name, ...] = ()
    """whose members may send commands"""
    clients: Count = 8
    """connections at a time; one more, and that which was silent longest is closed"""
    message_bytes: Annotated[int, Field(ge=64, le=65536)] = 1024
    rate_hz: Positive = 20.0
    """messages a second and client, in the long run; the others wait, an emergency stop never"""
    burst: Count = 20
    backlog: Count = 256
    """messages of a client that may wait; more are not kept, and that is answered"""


class SelfTest(Section):
    """What arming needs, looked at again and again while the drives are disabled."""

    interval_ms: Count = 100
    maximum_age_ms: Count = 250
    """an older result arms nothing"""
    patience_s: NonNegative = 2.0
    """how long a script waits for a good one"""
    slack_tension: Positive = 10.0
    """N: most that a cable of a disarmed robot pulls, or a zeroed cell may read"""
    brake_slip: Positive = 0.002
    """m: most that a cable moves at its drum while its holding brake is closed"""


class Firewall(Section):
    """What becomes of code beside control that raises."""

    failures: Count = 3
    """in a row, after which a part is not called again in this run"""


class Fallback(Section):
    """How a run ends in which control itself raised: passively to rest, then disabled."""

    rest_travel: Positive = 0.002
    """m of cable at a drum within which it counts as at rest"""
    rest_s: Positive = 0.5
    """for which every drum has to be at rest before the drives are disabled"""
    longest_s: Positive = 10.0
    """after which they are disabled in any case"""
    off_s: Positive = 1.0
    """longest wait for the drives to say that they are disabled"""


class Tunable(Section):
    """A parameter that an operator may change while the robot runs, and how far and fast."""

    key: Literal[
        "control.stiffness.deviation_gain",
        "control.stiffness.velocity_gain",
        "control.stiffness.force_gain",
    ]
    minimum: NonNegative
    maximum: Positive
    step: Positive
    """largest difference between the value in force and that of one command"""
    rate: Positive
    """1/s: how fast the value in force goes to that of a command"""

    @model_validator(mode="after")
    def _ordered(self) -> Tunable:
        if not self.minimum < self.maximum:
            raise ValueError("minimum < maximum must hold")
        return self


class Operation(Section):
    virtual_idle_speed: Positive = 1.0
    """times real time, at most, of a served run in virtual time while the robot is disarmed: it
    would record hours of standstill in minutes otherwise"""
    socket: ControlSocket = ControlSocket()
    self_test: SelfTest = SelfTest()
    firewall: Firewall = Firewall()
    fallback: Fallback = Fallback()
    tunable: tuple[Tunable, ...] = ()
    """parameters that `tonus ctl set` may change while the robot runs"""
    scenarios: tuple[Name, ...] | None = None
    """what an operator may choose from, by name or file; null: all that come with the package"""

    @model_validator(mode="after")
    def _each_once(self) -> Operation:
        keys = [each.key for each in self.tunable]
        twice = next((key for key in keys if keys.count(key) > 1), None)
        if twice is not None:
            raise ValueError(f"tunable has {twice} twice; give it once")
        return self
