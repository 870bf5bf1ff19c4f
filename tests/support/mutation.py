"""Change one operator, number or table row of a module at a time and see whether its tests notice.

Functions are changed in place (their code objects), so a mutant costs no import; tests run in this process.
"""

import ast
import copy
import gc
import inspect
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
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


@dataclass(frozen=True)
class Mutant:
    """One change; `apply` makes it and returns what undoes it."""

    name: str
    apply: Callable[[], Callable[[], None]]


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


class _Replace(ast.NodeTransformer):
    def __init__(self, target: ast.AST, by: ast.AST) -> None:
        self._target, self._by = target, by

    def visit(self, node: ast.AST) -> Any:
        return self._by if node is self._target else super().generic_visit(node)


def function_mutants(module: ModuleType) -> Iterator[Mutant]:
    """Mutants of everything inside functions and lambdas of `module`."""
    source, path = inspect.getsource(module), str(module.__file__)
    lines = source.splitlines()
    functions = {
        _place(f.__code__): f
        for f in gc.get_objects()
        if isinstance(f, FunctionType) and f.__code__.co_filename == path
    }
    for statement in ast.parse(source).body:  # compiled alone: its functions' places are the same
        for node in list(ast.walk(statement)):
            for _, changed in changes(node):
                mutated = _Replace(node, changed).visit(copy_with(statement, node))
                module_of_it = ast.fix_missing_locations(ast.Module([mutated], []))
                codes = {_place(code): code for code in _codes(compile(module_of_it, path, "exec"))}
                differing = [p for p, f in functions.items() if p in codes and f.__code__ != codes[p]]
                if differing:
                    line = lines[node.lineno - 1].strip()
                    name = f"{module.__name__}: {ast.unparse(changed)}  in  {line}"
                    yield Mutant(name, _code_swap([(functions[p], codes[p]) for p in differing]))


def copy_with(tree: ast.AST, node: ast.AST) -> ast.AST:
    """A copy of `tree` that shares `node` itself, so that it can be found and replaced."""
    return copy.deepcopy(tree, {id(node): node})


def row_mutants(modules: list[ModuleType], tables: list[str]) -> Iterator[Mutant]:
    """Each table (a tuple of rules) without one of its rows."""
    for table in tables:
        rows = next(getattr(module, table) for module in modules if hasattr(module, table))
        for index, row in enumerate(rows):
            fewer = rows[:index] + rows[index + 1 :]
            users = [module for module in modules if hasattr(module, table)]
            yield Mutant(f"{table} without {row.key}", _attribute_swap(users, table, fewer))


def constant_mutants(modules: list[ModuleType], names: list[str]) -> Iterator[Mutant]:
    """Each module constant a tenth larger."""
    for name in names:
        users = [module for module in modules if hasattr(module, name)]
        larger = getattr(users[0], name) * 1.1 + 0.1
        yield Mutant(f"{name} = {larger:g}", _attribute_swap(users, name, larger))


def cases(module: ModuleType) -> list[Callable[[], None]]:
    """The tests of a module, parametrised ones unrolled, without those of hypothesis."""
    found = []
    for name, test in vars(module).items():
        if name.startswith("test_") and not hasattr(test, "hypothesis"):
            found += list(_unrolled(test))
    return found


def survives(mutant: Mutant, tests: list[Callable[[], None]]) -> bool:
    """Return whether no test notices; a test that does is moved to the front."""
    undo = mutant.apply()
    try:
        for index, test in enumerate(tests):
            try:
                test()
            except KeyboardInterrupt:
                raise
            except BaseException:  # pytest's failures are no Exceptions
                tests.insert(0, tests.pop(index))
                return False
        return True
    finally:
        undo()


def _unrolled(test: Callable[..., None]) -> Iterator[Callable[[], None]]:
    marks = [mark for mark in getattr(test, "pytestmark", []) if mark.name == "parametrize"]
    axes = [[_arguments(mark.args[0], values) for values in mark.args[1]] for mark in marks]
    for chosen in itertools.product(*axes):
        arguments = {name: value for axis in chosen for name, value in axis.items()}
        yield lambda arguments=arguments: test(**arguments)


def _arguments(names: Any, values: Any) -> dict[str, Any]:
    if isinstance(names, str) and "," not in names:
        return {names: values}
    listed = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
    return dict(zip(listed, values, strict=True))


def _place(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def _code_swap(pairs: list[tuple[FunctionType, CodeType]]) -> Callable[[], Callable[[], None]]:
    def apply() -> Callable[[], None]:
        before = [(function, function.__code__) for function, _ in pairs]
        for function, code in pairs:
            function.__code__ = code
        return lambda: [setattr(function, "__code__", code) for function, code in before] and None

    return apply


def _attribute_swap(modules: list[ModuleType], name: str, value: Any) -> Callable[[], Callable[[], None]]:
    def apply() -> Callable[[], None]:
        before = getattr(modules[0], name)
        for module in modules:
            setattr(module, name, value)
        return lambda: [setattr(module, name, before) for module in modules] and None

    return apply
