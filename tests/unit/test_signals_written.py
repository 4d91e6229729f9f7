"""Every signal of the record is written, and by one function: a signal has its line in
`tonus.runtime.signals` and one place where it gets its value."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tonus import runtime
from tonus.runtime.signals import TABLE

NAMES = {topic.name.rsplit("/", 1)[1] for topic in TABLE}


def topic_of(node: ast.expr, known: dict[str, str]) -> str | None:
    """The topic that an expression is a part of the record of: ``record.pose``,
    ``record[0].pose``, or a name that stands for one."""
    if isinstance(node, ast.Attribute) and node.attr in NAMES:
        return node.attr
    return known.get(node.id) if isinstance(node, ast.Name) else None


def aliases(function: ast.FunctionDef) -> dict[str, str]:
    """Names that stand for a topic in a function: arguments of its name, and what it assigns."""
    arguments = [each.arg for each in function.args.args]
    known = {name: name for name in arguments if name in NAMES}
    for statement in ast.walk(function):
        if not isinstance(statement, ast.Assign):
            continue
        for target in statement.targets:
            names, values = [target], [statement.value]
            if isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
                names, values = target.elts, statement.value.elts
            for name, value in zip(names, values, strict=True):
                topic = topic_of(value, {})
                if isinstance(name, ast.Name) and topic is not None:
                    known[name.id] = topic
    return known


def written(function: ast.FunctionDef) -> Iterator[tuple[str, str]]:
    """Topic and field of every assignment to a part of the record."""
    known = aliases(function)
    for node in ast.walk(function):
        for target in node.targets if isinstance(node, ast.Assign) else ():
            # A scalar of a compiled record is set without an index.
            field = target.value if isinstance(target, ast.Subscript) else target
            if isinstance(field, ast.Attribute):
                topic = topic_of(field.value, known)
                if topic is not None:
                    yield topic, field.attr


def writers() -> dict[tuple[str, str], set[str]]:
    found: dict[tuple[str, str], set[str]] = defaultdict(set)
    for path in Path(str(runtime.__file__)).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                for place in written(node):
                    found[place].add(f"{path.name}:{node.name}")
    return found


def test_each_signal_is_written_by_one_function() -> None:
    found = writers()
    for topic in TABLE:
        name = topic.name.rsplit("/", 1)[1]
        for field in topic.fields:
            places = found[name, field.name]
            assert len(places) == 1, f"{name}.{field.name} is written by {sorted(places)}"
