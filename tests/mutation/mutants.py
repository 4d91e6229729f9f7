"""Every small error of a source file: another comparison, sign or number, a line left out."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
}
_EXCHANGED = {"min": "max", "max": "min", "any": "all", "all": "any", "isfinite": "isnan"}


@dataclass(frozen=True)
class Mutant:
    """``where`` is the function, ``was`` and ``now`` the line before and after; equal ones in a
    function differ in ``number``. Together they outlive changes elsewhere in the file."""

    where: str
    line: int
    was: str
    now: str
    number: int
    tree: ast.Module

    @property
    def key(self) -> str:
        return f"{self.where}: {self.was} -> {self.now} #{self.number}"


def original(source: str) -> Mutant:
    """The file itself, which no test may fail with."""
    return Mutant("", 0, "", "", 0, ast.parse(source))


def mutants(source: str) -> Iterator[Mutant]:
    """In the order of the lines. Docstrings, annotations and texts of errors are left alone."""
    tree = ast.parse(source)
    seen: dict[tuple[str, str, str], int] = {}
    for where, statement in _statements(tree, ""):
        was = _line(statement)
        for changed in _changes(statement):
            now = "" if changed is None else _line(changed)
            if now == was:
                continue
            number = seen[where, was, now] = seen.get((where, was, now), 0) + 1
            made = _with(tree, statement, changed)
            yield Mutant(where, statement.lineno, was, now, number, made)


def _line(statement: ast.stmt) -> str:
    """Its own line, without the block below it."""
    head = copy.copy(statement)
    for name in ("body", "orelse", "handlers", "finalbody"):
        if getattr(head, name, None):
            setattr(head, name, [ast.Pass()] if name == "body" else [])
    return ast.unparse(ast.fix_missing_locations(head)).split("\n")[0]


def _statements(node: ast.AST, where: str) -> Iterator[tuple[str, ast.stmt]]:
    """Statements that do something, with the name of the function they stand in."""
    for name in ("body", "orelse", "handlers", "finalbody"):
        for each in getattr(node, name, []):
            if isinstance(each, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                yield from _statements(each, f"{where}.{each.name}".lstrip("."))
            elif isinstance(each, ast.ExceptHandler):
                yield from _statements(each, where)
            elif where and isinstance(each, ast.stmt) and not _is_text(each):
                yield where, each
                yield from _statements(each, where)


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _changes(statement: ast.stmt) -> Iterator[ast.stmt | None]:
    """Copies with one error each; None: the statement left out."""
    if isinstance(statement, ast.Raise | ast.Pass | ast.Import | ast.ImportFrom | ast.Assert):
        return
    plain = ast.Expr | ast.AugAssign | ast.Return | ast.Continue | ast.Break
    if isinstance(statement, plain) or _is_state(statement):
        yield None
    if isinstance(statement, ast.If | ast.While):
        for value in (True, False):
            made = copy.deepcopy(statement)
            made.test = ast.Constant(value)
            if not (isinstance(statement, ast.While) and value):
                yield made
    count = sum(1 for _ in _expressions(statement))
    for place in range(count):
        for kind in range(3):
            made = copy.deepcopy(statement)
            if _mutate(list(_expressions(made))[place], kind):
                yield made


def _is_state(statement: ast.stmt) -> bool:
    """An assignment to what may have a value already: an attribute or an element."""
    if not isinstance(statement, ast.Assign):
        return False
    return all(isinstance(each, ast.Attribute | ast.Subscript) for each in statement.targets)


def _expressions(statement: ast.stmt) -> Iterator[ast.AST]:
    """Of its own line, annotations left out."""
    blocks = {"body", "orelse", "handlers", "finalbody", "annotation", "returns", "type_comment"}
    for name, value in ast.iter_fields(statement):
        if name not in blocks:
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    yield from _parts(each)


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """Without what `zip` is told of lengths: that is a check of ours."""
    yield node
    for each in ast.iter_child_nodes(node):
        if not (isinstance(each, ast.keyword) and each.arg == "strict"):
            yield from _parts(each)


def _mutate(node: ast.AST, kind: int) -> bool:
    """Put error number ``kind`` into it; False if it has none of that number."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        others = _COMPARED.get(type(node.ops[0]), ())
        if kind < len(others):
            node.ops = [others[kind]()]
            return True
    elif isinstance(node, ast.BinOp) and kind == 0 and type(node.op) in _COMPUTED:
        node.op = _COMPUTED[type(node.op)]()
        return True
    elif isinstance(node, ast.BoolOp):
        if kind == 0:
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            return True
        if kind <= len(node.values) and len(node.values) > 1:
            del node.values[kind - 1]
            return True
    elif isinstance(node, ast.UnaryOp) and kind == 0:
        if isinstance(node.op, ast.Not | ast.Invert | ast.USub):
            node.op = ast.UAdd() if not isinstance(node.op, ast.Not) else ast.Not()
            if isinstance(node.op, ast.Not):
                node.operand = ast.UnaryOp(ast.Not(), node.operand)
            return True
    elif isinstance(node, ast.Constant) and not isinstance(node.value, str | bytes):
        return _other(node, kind)
    elif isinstance(node, ast.Name | ast.Attribute) and kind == 0:
        name = node.id if isinstance(node, ast.Name) else node.attr
        if name in _EXCHANGED:
            setattr(node, "id" if isinstance(node, ast.Name) else "attr", _EXCHANGED[name])
            return True
    return False


def _other(node: ast.Constant, kind: int) -> bool:
    value = node.value
    if isinstance(value, bool):
        node.value = not value
        return kind == 0
    if isinstance(value, int | float):
        node.value = (value + 1, value * 2 if abs(value) > 1 else value - 1)[kind % 2]
        return kind < 2
    return False


def _with(tree: ast.Module, old: ast.stmt, new: ast.stmt | None) -> ast.Module:
    """A copy of the file in which ``old`` is ``new``."""
    place = (old.lineno, old.col_offset, type(old))

    class Exchange(ast.NodeTransformer):
        def generic_visit(self, node: ast.AST) -> ast.AST:
            if isinstance(node, ast.stmt) and (node.lineno, node.col_offset, type(node)) == place:
                return ast.copy_location(new or ast.Pass(), node)
            return super().generic_visit(node)

    changed = Exchange().visit(copy.deepcopy(tree))
    assert isinstance(changed, ast.Module)
    return ast.fix_missing_locations(changed)
