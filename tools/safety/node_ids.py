"""The tests of a folder by file and name, from the syntax trees alone."""

from __future__ import annotations

import ast
from pathlib import Path


def collect_tests(folder: Path) -> dict[str, list[str]]:
    """Names of the tests of each ``test_*.py`` below ``folder``, by the file's name. Files of one
    name are one list."""
    found: dict[str, list[str]] = {}
    for file in sorted(folder.rglob("test_*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        found.setdefault(file.name, []).extend(_tests(tree))
    return found


def _tests(tree: ast.Module) -> list[str]:
    """Functions, methods of classes as ``Class::name``, and what is bound to a ``TestCase``."""
    found = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            if node.name.startswith("test_"):
                found.append(node.name)
        elif isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
            found += [f"{node.name}::{name}" for name in _methods(node)]
        elif isinstance(node, ast.Assign) and _is_test_case(node.value):
            found += [each.id for each in node.targets if isinstance(each, ast.Name)]
    return found


def _methods(node: ast.ClassDef) -> list[str]:
    return [
        each.name
        for each in node.body
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
        and each.name.startswith("test_")
    ]


def _is_test_case(value: ast.expr) -> bool:
    """``TestMachine = Machine.TestCase``, as hypothesis has it."""
    return isinstance(value, ast.Attribute) and value.attr == "TestCase"
