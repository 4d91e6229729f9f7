"""`tonus fault`: faults injected into a running lab, and a look at what it does.

There is one command for each kind of fault, made from the schema.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tonus.config.faults import KINDS, FaultField, FaultKind
from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.run.lab_door import ask

_HEXADECIMAL = ("code", "identifier", "index", "vendor", "product", "revision")
_SOCKET = click.Option(
    ["--socket", "path"],
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Control socket of the lab; by default lab.sock in this user's runtime directory.",
)


def _integer(field: FaultField) -> Callable[[str], int]:
    """A whole number within the field's bounds, also as 0x1F."""

    low = -math.inf if field.low is None else field.low
    high = math.inf if field.high is None else field.high

    def convert(value: str | int) -> int:
        try:
            number = int(value, 0) if isinstance(value, str) else value
        except ValueError:
            number = None
        if number is None or not low <= number <= high:
            raise click.BadParameter(f"{value!r} is not a whole number {field.bounds}".rstrip())
        return number

    return convert


class _Faults(click.Group):
    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A kind is found with hyphens as well."""
        return super().get_command(ctx, cmd_name.replace("-", "_"))


@click.group(cls=_Faults)
def fault() -> None:
    """Inject a fault into a running lab, now or after a delay.

    `tonus fault list` lists the kinds, `tonus fault KIND --help` describes one.
    """


@fault.command("list")
def list_kinds() -> None:
    """Tell every kind of fault with its options; no lab is needed."""
    for kind in KINDS.values():
        click.echo(f"{kind.name:<12} {kind.about}")
        for field in kind.fields:
            if field.name == "at":
                continue  # every kind has it
            need = "required" if field.required else _otherwise(field)
            value = field.bounds if field.choices else f"{field.type} {field.bounds}".rstrip()
            about = f"  {field.about}" if field.about else ""
            click.echo(f"{'':<15}{_option(field):<15}{value} ({need}){about}")


def _option(field: FaultField) -> str:
    return f"--{field.name.replace('_', '-')}"


def _otherwise(field: FaultField) -> str:
    return "optional" if field.default is None else f"else {json.dumps(field.default)}"


@click.option("--json", "as_json", is_flag=True, help="Print the lab's reply as it is.")
def _get(path: Path | None, as_json: bool) -> None:
    """Show the lab's channels, nodes and lasting faults."""
    told = ask({"op": "get"}, path)
    if as_json:
        click.echo(json.dumps(told, indent=2))
    else:
        _show(Console(highlight=False), told)


def _inject(kind: FaultKind) -> Callable[..., None]:
    def inject(path: Path | None, **given: Any) -> None:
        fields = {name: value for name, value in given.items() if value is not None}
        reply = ask({"op": "inject", "fault": {"kind": kind.name, **fields}}, path)
        del fields["at"]
        when = "done at" if reply["at"] <= reply["time"] else "will be done at"
        click.echo(f"{_words(kind.name, fields)}: {when} {reply['at']:.6f} s of lab time")

    return inject


def _words(kind: str, fields: dict[str, Any]) -> str:
    told = (
        f"{name}=0x{value:X}" if name in _HEXADECIMAL else f"{name}={value}"
        for name, value in fields.items()
    )
    return " ".join((kind, *told))


def _parameter(field: FaultField) -> click.Option:
    name = _option(field)
    flag = field.type == "boolean"
    about = "s from now" if field.name == "at" else field.about
    if field.type == "integer":
        about = "; ".join(part for part in (about, field.bounds) if part)
    return click.Option(
        [f"{name}/--no-{name.removeprefix('--')}" if flag else name],
        type=_type(field),
        nargs=3 if field.type == "vector" else 1,
        required=field.required,
        show_default=True,
        metavar=None if field.choices or flag else _metavar(field),
        help=about,
        # click takes a default of None for a value, even of a required option.
        **({} if field.default is None else {"default": field.default}),
    )


def _metavar(field: FaultField) -> str:
    return "X Y Z" if field.type == "vector" else field.type.upper()


def _type(field: FaultField) -> Any:
    if field.choices is not None:
        return click.Choice(field.choices)
    if field.type in ("number", "vector"):
        return FiniteRange(field.low, field.high, min_open=field.low_excluded)
    return {"integer": _integer(field), "boolean": bool, "string": str}[field.type]


def _show(console: Console, told: dict[str, Any]) -> None:
    console.print(f"lab time {told['time']:.3f} s   seed {told['seed']}")
    columns = list(dict.fromkeys(key for c in told["channels"].values() for key in c))
    plain = [key for key in columns if _is_plain(told["channels"], key)]
    table = Table("channel", title="Channels", title_justify="left")
    for key in plain:
        table.add_column(key.replace("_", " "), justify="right")
    for name, channel in told["channels"].items():
        table.add_row(escape(name), *(_cell(channel.get(key)) for key in plain))
    if told["channels"]:
        console.print(table)
    table = Table(
        "node", "device", "NMT", "state", "error", "cable", title="Nodes", title_justify="left"
    )
    for node in told["nodes"]:
        table.add_row(
            escape(f"{node['channel']}/{node['node']}"),
            node["device"],
            node["nmt"],
            node["state"] or "",
            f"0x{node['error']:04X}" if node["error"] else "",
            "" if node["plugged"] else "unplugged",
        )
    if told["nodes"]:
        console.print(table)
    if told["slaves"]:
        _show_slaves(console, told)
    for lasting in told["faults"]:
        fields = dict(lasting["fault"])
        words = _words(fields.pop("kind"), fields)
        console.print(escape(f"{words}: since {lasting['since']:.3f} s"), style="red")


def _show_slaves(console: Console, told: dict[str, Any]) -> None:
    for name, segment in told["segments"].items():
        counts = " ".join(f"{key} {value}" for key, value in segment.items() if key != "f")
        orders = " ".join(f"{key}={value}" for key, value in segment["f"].items() if value)
        console.print(escape(f"{name}: {counts} {orders}".rstrip()))
    table = Table(
        *("slave", "device", "AL state", "AL status", "drive", "error", "clock", "cable"),
        title="Slaves",
        title_justify="left",
    )
    for slave in told["slaves"]:
        cable = "" if slave["reachable"] else "cut off" if slave["powered"] else "no supply"
        table.add_row(
            escape(f"{slave['channel']}/{slave['slave'] + 1}"),
            slave["device"],
            slave["state_name"] + (" + ERROR" if slave["error"] else ""),
            f"0x{slave['code']:04X}" if slave["code"] else "",
            slave.get("drive_state", ""),
            f"0x{slave['drive_error']:04X}" if slave.get("drive_error") else "",
            f"{slave['clock_difference_ns']} ns",
            cable,
        )
    console.print(table)


def _is_plain(channels: dict[str, Any], key: str) -> bool:
    """Whether a figure fits into a cell; the rest is for --json."""
    return not any(isinstance(channel.get(key), dict | list) for channel in channels.values())


def _cell(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else "" if value is None else str(value)


_get_command = click.command("get")(_get)
_get_command.params.append(_SOCKET)
fault.add_command(_get_command)
for _each in KINDS.values():
    fault.add_command(
        click.Command(
            _each.name,
            callback=_inject(_each),
            params=[*map(_parameter, _each.fields), _SOCKET],
            help=_each.about,
        )
    )
