"""`tonus ctl`: commands to a running daemon, and a look at what it does."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from tonus.runtime.operation.verbs import VERBS
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools import output
from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.cli.tension_bars import bars
from tonus.tools.control_client import ControlClient

_LOOK_S = 0.1
_BESIDE_BARS = 16
"""characters of a line of bars that are none"""
_ON_THE_WAY = {
    "arm": (State.REFERENCING.name, State.PRETENSION.name),
    "stop": (State.SAFE_STOP.name,),
    "reset": (),
}
"""States in which a command that takes a while is still at work."""
_WANTED = {"arm": State.HOLD.name, "stop": State.STANDBY.name, "reset": State.STANDBY.name}
_STYLES = {"GREEN": "green", "AMBER": "yellow", "RED": "bold red"}

Reply = dict[str, Any]
_socket = click.option(
    "--socket",
    "path",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="The daemon's control socket; by default tonus.sock in this user's runtime directory.",
)
_json = click.option("--json", "as_json", is_flag=True, help="Print the daemon's reply as it is.")


@click.group()
def ctl() -> None:
    """Command a running daemon: exit code 0 done, 1 refused, 2 no daemon or bad usage.

    A daemon that waits for commands is started with `tonus run CONFIG --serve`.
    """


@ctl.command()
@_socket
@_json
def status(path: Path | None, as_json: bool) -> None:
    """Print what the daemon does, and which commands are allowed next."""
    with ControlClient(path) as daemon:
        reply = daemon.ask("status")
    if as_json or not reply["ok"]:
        _end(reply, as_json)
    Console(highlight=False).print(_table(reply))


@ctl.command()
@_socket
@_json
@click.option(
    "--rate", type=FiniteRange(0.1, 10.0), default=4.0, help="Status requests per second."
)
@click.option("--count", type=click.IntRange(min=1), help="End after this number of requests.")
def watch(path: Path | None, as_json: bool, rate: float, count: int | None) -> None:
    """Show the status again and again, on a terminal in full screen; Ctrl-C ends it."""
    console = Console(highlight=False, soft_wrap=True)
    with ControlClient(path) as daemon:
        looks = _looks(daemon, rate, count)
        if as_json:
            for reply in looks:
                click.echo(json.dumps(reply))
        elif console.is_terminal:
            with Live(console=console, auto_refresh=False, screen=True) as live:
                for reply in looks:
                    width = max(console.width - _BESIDE_BARS, 10)
                    shown = Group(_table(reply), bars(reply["tension_n"], width))
                    live.update(shown, refresh=True)
            console.print(_line(reply), markup=False)
        else:
            for reply in looks:
                console.print(_line(reply), markup=False)


def _looks(daemon: ControlClient, rate: float, count: int | None) -> Iterator[Reply]:
    seen = 0
    while (count is None or seen < count) and not output.reader_left():
        reply = daemon.ask("status")
        if not reply["ok"]:
            _end(reply, as_json=False)
        yield reply
        seen += 1
        clock.pause(1.0 / rate)


@ctl.command()
@click.argument("name")
@_socket
@_json
def scenario(name: str, path: Path | None, as_json: bool) -> None:
    """Choose what START plays: one of the names in the status. In HOLD or disarmed.

    Started from elsewhere than home, the platform goes home first. In the lab only the reference
    changes; the lab's own loads and faults stay those it was started with.
    """
    with ControlClient(path) as daemon:
        _end(daemon.ask("scenario", name=name), as_json)


@ctl.command(name="set")
@click.argument("assignment", metavar="KEY=VALUE")
@_socket
@_json
def set_(assignment: str, path: Path | None, as_json: bool) -> None:
    """Change a parameter of operation.tunable while the robot runs; its value goes there at its
    rate. `tonus ctl status` lists the parameters, with values and bounds.
    """
    key, _, text = assignment.partition("=")
    try:
        value = float(text)
    except ValueError as error:
        raise click.BadParameter(
            f"{assignment!r} is no KEY=VALUE with a number; "
            "for example control.stiffness.velocity_gain=0.4"
        ) from error
    with ControlClient(path) as daemon:
        _end(daemon.ask("set", key=key.strip(), value=value), as_json)


def _command(verb: str) -> Callable[..., None]:
    def command(path: Path | None, as_json: bool, wait: bool = False) -> None:
        with ControlClient(path) as daemon:
            reply = daemon.ask(verb)
            if reply["ok"] and wait:
                reply = _follow(daemon, verb, reply, say=not as_json)
        _end(reply, as_json)

    return command


def _follow(daemon: ControlClient, verb: str, reply: Reply, *, say: bool) -> Reply:
    """Wait until the command has come to its end, wherever that is."""
    state = reply["state"]
    if say:
        click.echo(reply["text"])
    while True:
        clock.pause(_LOOK_S)
        told = daemon.ask("status")
        if not told["ok"]:
            return told
        if told["state"] != state and say and told["state"] != _WANTED[verb]:
            click.echo(f"{told['state']}: {told['meaning']}")
        state = told["state"]
        if state not in _ON_THE_WAY[verb] and not told["recovering"]:
            return _outcome(verb, told)


def _outcome(verb: str, told: Reply) -> Reply:
    state = told["state"]
    reply = {"op": verb, "state": state, "next": told["next"]}
    if state == _WANTED[verb]:
        return {"ok": True, **reply, "text": f"{state}: {told['meaning']}"}
    return {
        "ok": False,
        "accepted": True,
        **reply,
        "error": told["fault"] or f"it is in {state} instead",
    }


def _end(reply: Reply, as_json: bool) -> None:
    """The last line, and the exit code."""
    if as_json:
        click.echo(json.dumps(reply, indent=2))
    elif reply["ok"]:
        click.echo(f"{reply['text']}; next: {reply['next']}")
    else:
        word = "failed" if reply.get("accepted") else "refused"
        click.echo(f"{word}: {reply['error']}; {reply['next']}", err=True)
    raise click.exceptions.Exit(0 if reply["ok"] else 1)


def _line(told: Reply) -> str:
    """A status in one line."""
    low, high = min(told["tension_n"]), max(told["tension_n"])
    text = (
        f"{told['state']:<11} {told['scenario']} {told['scenario_s']:.1f} of"
        f" {told['duration_s']:.1f} s  K_eq {told['k_eq_n_per_m']:.0f} N/m"
        f"  tension {low:.1f} .. {high:.1f} N  {told['grade'].lower()}"
        f"  missed {told['missed_own']} own {told['missed_host']} host"
    )
    return f"{text}  {told['fault']}" if told["fault"] else text


def _table(told: Reply) -> Table:
    """A status for a person."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()

    def row(name: str, text: str, style: str = "") -> None:
        table.add_row(name, f"[{style}]{escape(text)}[/]" if style else escape(text))

    fault = told["fault"]
    bold = "bold red" if fault else "bold green" if told["armed"] else "bold"
    row("state", f"{told['state']} for {told['elapsed_s']:.1f} s: {told['meaning']}", bold)
    if fault:
        row("fault", fault, "red")
    if told["recovering"]:
        row("reset", "devices are being brought back")
    row("next", told["next"] if told["served"] else "a script runs this daemon; stop or estop it")
    row("robot", f"{told['config']}, controller {told['controller']}")
    played = f"{told['scenario_s']:.1f} of {told['duration_s']:.1f} s"
    row("scenario", f"{told['scenario']}, {played} played")
    if told["served"]:
        row("to choose", ", ".join(told["scenarios"]))
        for each in told["tunable"]:
            target = each["target"]
            way = "" if target == each["value"] else f", on its way to {target:g}"
            bounds = f"{each['minimum']:g} to {each['maximum']:g}"
            row("to set", f"{each['key']} {each['value']:g}{way} ({bounds})")
    for found in told["self_test"]:
        style = "" if found["ok"] else "red"
        row(found["item"], f"{'ok: ' if found['ok'] else 'FAILED: '}{found['text']}", style)
    if told["armed"]:
        row("stiffness", f"K_eq {told['k_eq_n_per_m']:.0f} N/m")
        row("envelope", told["grade"].lower(), _STYLES[told["grade"]])
        x, y, z = (1e3 * each for each in told["position_m"])
        row("position", f"{x:.1f} {y:.1f} {z:.1f} mm")
    row("tensions", " ".join(f"{tension:.1f}" for tension in told["tension_n"]) + " N")
    row("contact", f"{told['contact_n']:.1f} N")
    row("missed", f"{told['missed_own']} own, {told['missed_host']} by the host")
    row("log", told["log"])
    return table


for _verb in ("arm", "start", "hold", "stop", "estop", "reset"):
    _made = click.command(_verb, help=f"{VERBS[_verb].about[0].upper()}{VERBS[_verb].about[1:]}.")(
        _json(_socket(_command(_verb)))
    )
    if _verb in _WANTED:
        _made.params.append(
            click.Option(["--wait/--no-wait"], default=True, help="Wait for its end, or not.")
        )
    ctl.add_command(_made)
