"""The kinds of fault as the tables that lie in docs/faults.md."""

from __future__ import annotations

import json
import sys

from tonus.config.faults import KINDS, FaultField


def tables() -> str:
    """A row for each kind, then one for each field; printed from the schema."""
    kinds = ["| kind | what happens | takes |", "|---|---|---|"]
    fields = ["| field | value | meaning |", "|---|---|---|"]
    for kind in KINDS.values():
        # Every kind has a time, so it stands among the fields only.
        names = ", ".join(_name(field) for field in kind.fields if field.name != "at")
        kinds.append(f"| `{kind.name}` | {kind.about} | {names} |")
        for field in kind.fields:
            value = field.bounds.replace(" | ", ", ") if field.choices else _value(field)
            row = f"| `{field.name}` | {value} | {field.about} |"
            if row not in fields:
                fields.append(row)
    return "\n".join([*kinds, "", *fields]) + "\n"


def _name(field: FaultField) -> str:
    if field.required:
        return f"`{field.name}`"
    default = "" if field.default is None else f" {json.dumps(field.default)}"
    return f"[`{field.name}`{default}]"


def _value(field: FaultField) -> str:
    return f"{field.type} {field.bounds}".rstrip()


if __name__ == "__main__":
    sys.stdout.write(tables())
