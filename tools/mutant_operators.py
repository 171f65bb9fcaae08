"""Mutation operators for Python: small changes of a syntax tree that a test should notice.

The operators follow those of mutmut and Cosmic Ray, plus three that controllers need and that
neither has: a dropped limit (`min`, `max`, `clip`), a dropped `abs`, and a dropped statement. A
mutant that fails at once in any test, such as `return None`, is not made: it would only raise the
score.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

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
# Exchanged between whole numbers only: between real numbers, one value in 2^53 would differ.
BOUNDARIES = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
EXTREMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "fmin": "fmax",
    "fmax": "fmin",
    "any": "all",
    "all": "any",
}
# Calls of several arguments that a mutant replaces by the first of them.
LIMITS = {"min", "max", "minimum", "maximum", "fmin", "fmax", "clip"}
# Calls of one argument that a mutant drops.
DROPPED = {"abs", "fabs", "absolute"}
# Nodes whose text nobody computes with.
SKIPPED = (ast.Assert, ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom)


@dataclass(frozen=True)
class Mutation:
    """A change of a syntax tree.

    Attributes:
      operator: name of the operator.
      node: replaced node; replacement: new node, in its place.
      parent, field, index: place of the node; index is None unless the field is a list.
      function: qualified name of the enclosing function or class, empty on module level.
      lines: first and last line of the statement, or of its head, that contains the node.
      at_import: whether the line runs when the module is imported.
    """

    operator: str
    node: ast.AST
    replacement: ast.AST
    parent: ast.AST
    field: str
    index: int | None
    function: str
    lines: tuple[int, int]
    at_import: bool

    @property
    def line(self) -> int:
        """Line of the node in the source."""
        return int(getattr(self.node, "lineno", self.lines[0]))

    def apply(self) -> None:
        """Changes the tree."""
        ast.copy_location(self.replacement, self.node)
        ast.fix_missing_locations(self.replacement)
        if self.index is None:
            setattr(self.parent, self.field, self.replacement)
        else:
            getattr(self.parent, self.field)[self.index] = self.replacement


@dataclass(frozen=True)
class _Place:
    function: tuple[str, ...] = ()
    lines: tuple[int, int] = (1, 1)
    at_import: bool = True
    setting: bool = False


def mutations(tree: ast.Module) -> Iterator[Mutation]:
    """All mutations of a module, in the order of its source.

    The default value of a field of a class has the operator `setting`: it is a choice, which a test
    can only repeat.
    """
    yield from _visit(tree, _Place())


def _visit(parent: ast.AST, place: _Place) -> Iterator[Mutation]:
    for field, value in ast.iter_fields(parent):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        entries = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for index, node in entries:
            if not isinstance(node, ast.AST) or isinstance(node, SKIPPED) or _typing_only(node):
                continue
            here = _enter(parent, node, place)
            for operator, replacement in _replacements(parent, node):
                name = "setting" if here.setting else operator
                function = ".".join(here.function)
                yield Mutation(
                    name, node, replacement, parent, field, index, function, here.lines,
                    here.at_import,
                )  # fmt: skip
            yield from _visit(node, here)


def _typing_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _enter(parent: ast.AST, node: ast.AST, place: _Place) -> _Place:
    """Place of a node: its function, its statement, and whether it runs at import."""
    function, lines, at_import, setting = (
        place.function,
        place.lines,
        place.at_import,
        place.setting,
    )
    if isinstance(parent, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        function = (*function, parent.name)
    if isinstance(parent, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        at_import = at_import and isinstance(node, ast.arguments)
    if isinstance(node, ast.stmt):
        body = getattr(node, "body", None)
        end = body[0].lineno - 1 if body else node.end_lineno or node.lineno
        lines = node.lineno, max(end, node.lineno)
        setting = isinstance(parent, ast.ClassDef) and isinstance(node, ast.AnnAssign)
    return _Place(function, lines, at_import, setting)


def _replacements(parent: ast.AST, node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Operators and new nodes for one node."""
    if isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        for k, op in enumerate(node.ops):
            whole = any(_is_whole(operand) for operand in operands[k : k + 2])
            for other in COMPARISONS[type(op)]:
                if other is BOUNDARIES.get(type(op)) and not whole:
                    continue
                yield "comparison", _with(node, ops=[*node.ops[:k], other(), *node.ops[k + 1 :]])
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        if not (isinstance(node.left, ast.Constant) and isinstance(node.left.value, str)):
            yield "arithmetic", _with(node, op=ARITHMETIC[type(node.op)]())
    elif isinstance(node, ast.AugAssign) and type(node.op) in ARITHMETIC:
        yield "arithmetic", _with(node, op=ARITHMETIC[type(node.op)]())
        yield "dropped statement", ast.Pass()
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield "dropped sign" if isinstance(node.op, ast.USub) else "dropped not", node.operand
    elif isinstance(node, ast.BoolOp):
        yield "and, or", _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.Constant):
        yield from _constants(node)
    elif isinstance(node, ast.Call):
        yield from _calls(node)
    elif isinstance(node, ast.Break):
        yield "break, continue", ast.Continue()
    elif isinstance(node, ast.Continue):
        yield "break, continue", ast.Break()
    elif (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield "dropped statement", ast.Pass()
    test = isinstance(parent, ast.If | ast.IfExp | ast.While) and node is parent.test
    if test and isinstance(node, ast.Name | ast.Attribute | ast.Call | ast.BoolOp):
        yield "negated condition", ast.UnaryOp(ast.Not(), node)


def _is_whole(node: ast.expr) -> bool:
    """Whether the source shows that a value is a whole number."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    if isinstance(node, ast.Call):
        return getattr(node.func, "id", "") == "len"
    return isinstance(node, ast.Attribute) and node.attr == "size"


def _constants(node: ast.Constant) -> Iterator[tuple[str, ast.AST]]:
    value = node.value
    if isinstance(value, bool):
        yield "constant", ast.Constant(not value)
    elif isinstance(value, int):
        yield "constant", ast.Constant(value + 1)
    elif isinstance(value, float):
        yield "constant", ast.Constant(2.0 * value if value else 1.0)


def _calls(node: ast.Call) -> Iterator[tuple[str, ast.AST]]:
    function = node.func
    name = getattr(function, "id", getattr(function, "attr", ""))
    if name in EXTREMES:
        other = copy.deepcopy(function)
        if isinstance(other, ast.Name):
            other.id = EXTREMES[name]
        elif isinstance(other, ast.Attribute):
            other.attr = EXTREMES[name]
        yield "least, greatest", _with(node, func=other)
    if name in LIMITS and len(node.args) > 1:
        yield "dropped limit", node.args[0]
        if name != "clip" and len(node.args) == 2:
            yield "dropped limit", node.args[1]
    if name in DROPPED and len(node.args) == 1:
        yield "dropped abs", node.args[0]


def _with(node: ast.AST, **fields: object) -> ast.AST:
    """A shallow copy of a node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new
