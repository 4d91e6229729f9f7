"""Every small error of a source file: another comparison, sign or number, a line left out."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass, field

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


_KINDS = 6
"""errors that are put into one expression, at most"""
_BLOCKS = {"body", "orelse", "handlers", "finalbody"}


@dataclass(frozen=True)
class Mutant:
    """``where`` is the function, ``was`` and ``now`` the line before and after; equal ones in a
    function differ in ``number``. Together they outlive changes elsewhere in the file."""

    where: str
    line: int
    last: int
    """of its lines, without the block below it"""
    was: str
    now: str
    number: int
    source: str = field(repr=False)
    place: tuple[int, int] = field(repr=False)
    """line and column of the statement that is changed"""
    changed: ast.stmt | None = field(repr=False)
    """what is there instead; None: nothing"""

    @property
    def key(self) -> str:
        return f"{self.where}: {self.was} -> {self.now} #{self.number}"

    @property
    def tree(self) -> ast.Module:
        """The whole file with the error in it, parsed anew."""
        tree = ast.parse(self.source)
        if self.line:
            _exchange(tree, self.place, self.changed or ast.Pass())
        return ast.fix_missing_locations(tree)


def original(source: str) -> Mutant:
    """The file itself, which no test may fail with."""
    return Mutant("", 0, 0, "", "", 0, source, (0, 0), None)


def mutants(source: str) -> Iterator[Mutant]:
    """In the order of the lines. Docstrings, annotations and texts of errors are left alone."""
    seen: dict[tuple[str, str, str], int] = {}
    for where, statement in _statements(ast.parse(source), ""):
        was = _line(statement)
        first, last = statement.lineno, _last(statement)
        place = first, statement.col_offset
        for changed in _changes(statement):
            now = "" if changed is None else _line(changed)
            if now == was:
                continue
            number = seen[where, was, now] = seen.get((where, was, now), 0) + 1
            yield Mutant(where, first, last, was, now, number, source, place, changed)


def _last(statement: ast.stmt) -> int:
    """The last line of its own, without the block below it."""
    block = getattr(statement, "body", None)
    if not isinstance(block, list):
        return statement.end_lineno or statement.lineno
    return max(statement.lineno, block[0].lineno - 1)


def _line(statement: ast.stmt) -> str:
    """Its own line, without the block below it."""
    head = copy.copy(statement)
    for name in _BLOCKS:
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
            made = _head(statement)
            made.test = ast.Constant(value)
            if not (isinstance(statement, ast.While) and value):
                yield made
    count = sum(1 for _ in _expressions(statement))
    for place in range(count):
        for kind in range(_KINDS):
            made = _head(statement)
            if _mutate(list(_expressions(made))[place], kind):
                yield made


def _head(statement: ast.stmt) -> ast.stmt:
    """A copy of its own line; the block below it is the same."""
    made = copy.copy(statement)
    for name, value in ast.iter_fields(statement):
        if name not in _BLOCKS:
            setattr(made, name, copy.deepcopy(value))
    return made


def _is_state(statement: ast.stmt) -> bool:
    """An assignment to what may have a value already: an attribute or an element."""
    if not isinstance(statement, ast.Assign):
        return False
    return all(isinstance(each, ast.Attribute | ast.Subscript) for each in statement.targets)


def _expressions(statement: ast.stmt) -> Iterator[ast.AST]:
    """Of its own line, annotations left out."""
    others = {*_BLOCKS, "annotation", "returns", "type_comment"}
    for name, value in ast.iter_fields(statement):
        if name not in others:
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
    if isinstance(node, ast.Compare):
        others = [(n, new) for n, op in enumerate(node.ops) for new in _COMPARED.get(type(op), ())]
        if kind < len(others):
            number, new = others[kind]
            node.ops[number] = new()
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


def _exchange(node: ast.AST, place: tuple[int, int], new: ast.stmt) -> bool:
    """Put ``new`` where the statement of this place is."""
    for name in _BLOCKS:
        block = getattr(node, name, None)
        for number, each in enumerate(block if isinstance(block, list) else ()):
            if isinstance(each, ast.stmt) and (each.lineno, each.col_offset) == place:
                block[number] = ast.copy_location(new, each)
                return True
            if _exchange(each, place, new):
                return True
    return False
