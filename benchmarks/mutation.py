"""Faults of one token or one statement, and the lot that draws them: what ``mutants.py`` tries."""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "safety_harness"
UNIT = re.compile(r"_(m|s|px|rad|mps|radps)$")

NEGATED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
TOUCHING = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPPOSITE: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr, ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult,
}  # fmt: skip
NOT_SWAPPED = {
    "isinstance",
    "hasattr",
    "getattr",
    "zeros",
    "full",
    "empty",
    "asarray",
    "array",
}  # stop at once
OTHER = {"min": "max", "max": "min", "ceil": "floor", "floor": "ceil"}


@dataclass(frozen=True, order=True)
class Mutant:
    """A piece of a file, from ``start`` to ``end`` in bytes, and what stands there instead."""

    file: str
    operator: str
    line: int
    start: int
    end: int
    before: str
    after: str

    def applied(self, source: bytes) -> bytes:
        """The file with the fault in it."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST, str]]:
    """(operator, what is replaced, by what) for one node."""
    text = ast.unparse
    match node:
        case ast.Compare(left, [op], [right]):
            for name, table in (("comparison flipped", NEGATED), ("comparison at a tie", TOUCHING)):
                if type(op) in table:
                    yield name, node, text(ast.Compare(left, [table[type(op)]()], [right]))
        case ast.BoolOp(op, values):
            other = ast.And() if isinstance(op, ast.Or) else ast.Or()
            yield "and/or swapped", node, f"({text(ast.BoolOp(other, values))})"
        case ast.UnaryOp(ast.USub(), operand):
            yield "sign flipped", node, text(operand)
        case ast.UnaryOp(ast.Not(), operand):
            yield "condition negated", node, f"({text(operand)})"
        case ast.BinOp(left, op, right) if type(op) in OPPOSITE:
            yield _name(op), node, f"({text(ast.BinOp(left, OPPOSITE[type(op)](), right))})"
        case ast.Constant(bool(value)):
            yield "constant changed", node, str(not value)
        case ast.Constant(int(value)):
            for near in (value - 1, value + 1):
                yield "off by one", node, f"({near})"
        case ast.Constant(float(value)):
            yield "constant changed", node, repr(0.0 if 0.0 < value < 1e-6 else round(1.1 * value, 9) or 0.1)
        case ast.Call(ast.Name("range"), arguments):
            for by in ("- 1", "+ 1"):
                yield "loop bound", arguments[-1], f"({text(arguments[-1])}) {by}"
        case ast.Call(function, arguments):
            name = text(function).rsplit(".")[-1]
            if name in OTHER:
                both_names = "/".join(sorted((name, OTHER[name])))
                yield f"{both_names} swapped", function, text(function).replace(name, OTHER[name])
            elif len({*map(ast.dump, arguments)}) > 1 and name not in NOT_SWAPPED:
                for k in range(len(arguments) - 1):
                    both = [*arguments[:k], arguments[k + 1], arguments[k], *arguments[k + 2 :]]
                    yield "arguments swapped", node, text(ast.Call(function, both, node.keywords))
        case ast.Name(name, ast.Load()) | ast.Attribute(_, name, ast.Load()) if UNIT.search(name):
            yield "wrong unit", node, f"(1000.0 * {text(node)})"
        case ast.Subscript(ast.Name(name) | ast.Attribute(_, name), _, ast.Load()) if UNIT.search(name):
            yield "wrong unit", node, f"(1000.0 * {text(node)})"
    match node:
        case ast.If(test, body, orelse):
            yield "condition negated", test, f"not ({text(test)})"
            if not orelse and isinstance(body[-1], (ast.Return, ast.Continue)):
                yield "guard deleted", test, "False"
        case ast.IfExp(test, one, other):
            yield "condition negated", node, f"({text(ast.IfExp(test, other, one))})"
        case ast.Expr(ast.Call()) | ast.Continue():
            yield "statement deleted", node, "pass"
        case ast.AugAssign(target, op, value):
            yield "statement deleted", node, "pass"
            if type(op) in OPPOSITE:
                yield _name(op), node, text(ast.AugAssign(target, OPPOSITE[type(op)](), value))
        case ast.Assign([ast.Attribute() | ast.Subscript()]):
            yield "statement deleted", node, "pass"
        case ast.For(_, _, [*some, ast.Assign() | ast.AugAssign() | ast.Expr() as last]):
            if not some or not isinstance(some[0], ast.If):
                yield "early end of a loop", last, f"{text(last)}; break"


def _name(op: ast.operator) -> str:
    return "sign flipped" if isinstance(op, (ast.Add, ast.Sub)) else "other operation"


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Every node that does something: no annotations, decorators, words of errors, layouts of records."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            match child:
                case (
                    ast.Raise() | ast.Expr(ast.Constant()) | ast.Call(ast.Attribute(ast.Name("np"), "dtype"))
                ):
                    continue
                case ast.AST():
                    yield child
                    yield from _nodes(child)


def mutants_of(path: Path) -> list[Mutant]:
    """Every mutant of a file, in a fixed order."""
    source = path.read_bytes()
    lines = [0]
    for line in source.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    tree = ast.parse(source)
    # a call's function and a subscript's base are no values of their own
    bases = {id(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)}
    bases |= {id(n.value) for n in ast.walk(tree) if isinstance(n, (ast.Subscript, ast.Attribute))}
    found = set()
    for node in _nodes(tree):
        if id(node) in bases and isinstance(node, (ast.Name, ast.Attribute)):
            continue
        for operator, place, after in _changes(node):
            assert isinstance(place, (ast.expr, ast.stmt))
            assert place.end_lineno is not None
            assert place.end_col_offset is not None
            start = lines[place.lineno - 1] + place.col_offset
            end = lines[place.end_lineno - 1] + place.end_col_offset
            name, before = path.relative_to(PACKAGE).as_posix(), source[start:end].decode()
            found.add(Mutant(name, operator, place.lineno, start, end, before, after))
    return sorted(found)


def by_lot(path: Path, seed: int) -> Iterator[Mutant]:
    """All mutants of a file in the order in which they are drawn: an operator, then a place for it."""
    lot = random.Random(f"{seed} {path.relative_to(PACKAGE).as_posix()}")
    left: dict[str, list[Mutant]] = {}
    for mutant in mutants_of(path):
        left.setdefault(mutant.operator, []).append(mutant)
    while left:
        operator = lot.choice(sorted(left))
        yield left[operator].pop(lot.randrange(len(left[operator])))
        if not left[operator]:
            del left[operator]
