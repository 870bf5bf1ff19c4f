"""One small change of an expression at a time: the operators of mutation testing, on Python's syntax tree."""

import ast
import copy
from collections.abc import Iterator
from typing import Any

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
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
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
OPPOSITE = {"min": "max", "max": "min"}


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield each way to change one operator or value of `node`: its kind and the changed node."""
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    ops = [other() if k == index else op for k, op in enumerate(node.ops)]
                    yield "comparison", _with(node, ops=ops)
        case ast.BoolOp():
            yield "boolean", _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
        case ast.BinOp() if type(node.op) in ARITHMETIC:
            yield "arithmetic", _with(node, op=ARITHMETIC[type(node.op)]())
        case ast.UnaryOp(op=ast.Not()):
            yield "boolean", node.operand
        case ast.IfExp():
            yield "boolean", _with(node, body=node.orelse, orelse=node.body)
        case ast.Call(func=ast.Name(id="min" | "max")):
            yield from (("min/max", other) for other in _other_extremes(node))
        case ast.Constant() | ast.Return():
            yield from (("constant", other) for other in _other_values(node))


def _other_extremes(call: ast.Call) -> Iterator[ast.AST]:
    assert isinstance(call.func, ast.Name)
    yield _with(call, func=ast.Name(OPPOSITE[call.func.id], ast.Load()))
    if len(call.args) > 1 and not any(isinstance(item, ast.Starred) for item in call.args):
        yield from (_without(call, dropped) for dropped in range(len(call.args)))


def _without(call: ast.Call, dropped: int) -> ast.AST:
    args = [item for index, item in enumerate(call.args) if index != dropped]
    return args[0] if len(args) == 1 else _with(call, args=args)


def _other_values(node: ast.Constant | ast.Return) -> Iterator[ast.AST]:
    match node:
        case ast.Constant(value=bool()):
            yield _with(node, value=not node.value)
        case ast.Constant(value=float(value)) if value:
            yield _with(node, value=value * 2.0)
            yield _with(node, value=value / 2.0)
        case ast.Constant(value=int(value) | float(value)):
            yield _with(node, value=value + 1)
        case ast.Return(value=ast.Constant(value="")):
            yield _with(node, value=ast.Constant("changed"))
        case ast.Return(value=ast.Constant(value=str()) | ast.JoinedStr()):
            yield _with(node, value=ast.Constant(""))


def _with(node: ast.AST, **changed: Any) -> ast.AST:
    other = copy.copy(node)
    for name, value in changed.items():
        setattr(other, name, value)
    return other
