"""Code of expressions and instructions: from syntax to the VM's instructions; values known before anything runs.

User-defined functions are curves by control points, as cpfg's function editor makes them: those of a clamped cubic
B-spline (of lower degree where there are fewer than four). The curve begins at the first, ends at the last, and its
value at x is where it crosses x. Outside, the end values hold.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import NoReturn

import numpy as np

from forestgen.lsystem import syntax
from forestgen.lsystem import vm_layout as op
from forestgen.lsystem.multiset import Kind
from forestgen.lsystem.syntax import FIRST, Place, fail

GROUP = ""  # name of the first global variable, which holds the current group
_MOST_INSTRUCTIONS = 200_000
_MOST_KINDS = 65_536
_SYMBOL = syntax.Name | syntax.Number  # what a symbol looks like as an argument
_SAMPLES_A_SPAN = 64
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "min": min, "max": max, "floor": math.floor, "ceil": math.ceil, "trunc": math.trunc, "abs": abs, "fabs": abs,
    "exp": math.exp, "sqrt": math.sqrt, "pow": math.pow, "log": math.log,
    "sin": lambda x: math.sin(math.radians(x)), "cos": lambda x: math.cos(math.radians(x)),
}  # fmt: skip
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "%": math.fmod, "^": math.pow,
    "==": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "&&": lambda a, b: bool(a) and bool(b), "||": lambda a, b: bool(a) or bool(b),
}  # fmt: skip


class CodeGenerator:
    """Grows a program's two tables: `whole`, with the code, and `real`, with the numbers that it works on.

    Local variables come first in `real`, then room for a copy of them; the stack comes last.
    """

    def __init__(self, ast: syntax.ProgramAST) -> None:
        self.name, self.macros = ast.name, ast.macros
        self.whole, self.places = [0] * op.HEADER, dict[int, Place]()  # of each instruction, by its address
        sizes = [
            len({*(name for name, _ in formals(one)), *_assigned_in(one.before, one.after)})
            for one in ast.all_productions
        ]
        self.whole[op.LOCAL_SIZE] = max(sizes, default=0)
        self.real = [0.0] * (2 * self.whole[op.LOCAL_SIZE])
        self.arrays: dict[str, int] = {}  # name -> address in `whole` of its first and last address in `real`
        for name, values in ast.arrays.items():
            first = self.append_reals(values)
            self.arrays[name] = self.append([first, first + len(values)])
        # A function's number is its name, or the next that is free, from 1 on.
        numbers = {name: int(name) for name in ast.functions if name.isdigit()}
        free = (number for number in count(1) if number not in numbers.values())
        self.functions = {name: numbers[name] if name in numbers else next(free) for name in ast.functions}
        self._lay_out_functions(ast)
        names = _assigned_in(ast.start, ast.start_each, ast.end_each, ast.end)
        self.globals = {one: self.append_reals([0.0]) for one in (GROUP, *names)}  # name -> address
        self.counted: list[tuple[int, str]] = []  # number of the global that holds how many modules of a symbol
        self.groups = {0, *(one.group for one in ast.productions)}
        self.constants: dict[float, int] = {}  # value -> address
        self.kinds: dict[Kind, int] = {}
        self.stack = self.stack_size = 0

    def _lay_out_functions(self, ast: syntax.ProgramAST) -> None:
        """Of each number from 1 on, where its function's samples are and how many: 0, there is no such function."""
        pairs = dict.fromkeys(range(1, max(self.functions.values(), default=0) + 1), (0, 0))
        for name, points in ast.functions.items():
            x, y = _sampled(points)
            pairs[self.functions[name]] = self.append_reals([*x, *y]), len(x)
        self.whole[op.FUNCTIONS] = len(pairs)
        self.whole[op.FUNCTION_AT] = self.append([one for pair in pairs.values() for one in pair])

    def fail(self, problem: str, place: Place, **about: str | None) -> NoReturn:
        fail(problem, self.name, place, **about)

    def append(self, values: Sequence[int]) -> int:
        """The address in `whole` where the values begin."""
        self.whole += values
        return len(self.whole) - len(values)

    def append_reals(self, values: Sequence[float]) -> int:
        """The address in `real` where the values begin."""
        self.real += values
        return len(self.real) - len(values)

    def kind(self, symbol: str, arity: int) -> int:
        code = self.kinds.setdefault(Kind(symbol, arity), len(self.kinds))
        if code >= _MOST_KINDS:
            self.fail("too many kinds of modules", FIRST, expected=f"at most {_MOST_KINDS:,}")
        return code

    def put(self, operation: int, place: Place, change: int, operand: int = 0) -> int:
        """Append an instruction that changes the stack's height by `change`; its address."""
        if len(self.places) >= _MOST_INSTRUCTIONS:
            self.fail("the program is too long", place, expected=f"at most {_MOST_INSTRUCTIONS} instructions")
        self.stack += change
        self.stack_size = max(self.stack_size, self.stack)
        self.places[len(self.whole)] = place
        return self.append([operation, operand])

    def land(self, jump: int) -> None:
        """Let an earlier jump go to where code is emitted next."""
        self.whole[jump + 1] = len(self.whole)

    def constant(self, value: float, place: Place) -> None:
        if value not in self.constants:
            self.constants[value] = self.append_reals([value])
        self.put(op.LOAD, place, 1, self.constants[value])


class Scope:
    """Code of one production or block: its names are the formal parameters and local variables."""

    def __init__(
        self, code: CodeGenerator, formals: Sequence[tuple[str, Place]] = (), *, is_global: bool = False
    ) -> None:
        self.e, self.is_global, self.fail = code, is_global, code.fail
        self.locals: dict[str, int] = {}
        self.expanding: list[str] = []
        self.bound: list[Mapping[str, syntax.Expression]] = []  # a macro's parameters
        for name, place in formals:
            if name in self.locals:
                self.fail(f"the parameter {name} stands twice in one production", place, hint="give each its own name")
            self.locals[name] = len(self.locals)

    def begin(self) -> int:
        """The address where code that is emitted next begins."""
        self.e.stack = 0
        return len(self.e.whole)

    def statements(self, statements: Sequence[syntax.Statement]) -> None:
        for one in statements:
            if isinstance(one, syntax.If):
                self.branches(one)
            elif isinstance(one, syntax.UseGroup):
                if not self.is_global:
                    expected = "it in Start, StartEach or EndEach"
                    self.fail("useGroup stands in a production", one.place, expected=expected)
                value = fold(one.group, {}, self.e.name)
                if value is not None and value not in self.e.groups:
                    known = ", ".join(map(str, sorted(self.e.groups)))
                    self.fail("there is no such group", one.place, expected=known, got=f"{value:g}")
                self.expression(one.group)
                self.e.put(op.STORE, one.place, -1, self.e.globals[GROUP])
            else:
                self.expression(one.value)
                self.assign_to(one.name, one.place)

    def assign_to(self, name: str, place: Place) -> None:
        """The value on the stack becomes a variable's."""
        if self.is_global:
            self.e.put(op.STORE, place, -1, self.e.globals[name])
            return
        if name in self.e.globals:
            problem = f"a production assigns the global variable {name}"
            self.fail(problem, place, expected="local variables: all modules are rewritten at once")
        if name in self.e.macros or name in self.e.arrays:
            self.fail(f"{name} is defined and cannot be assigned", place)
        self.e.put(op.STORE, place, -1, self.locals.setdefault(name, len(self.locals)))

    def branches(self, one: syntax.If) -> None:
        for name in _assigned_in((one,)):
            if not self.is_global and name not in self.locals:  # 0 where no branch sets it
                self.e.constant(0.0, one.place)
                self.assign_to(name, one.place)
        self.expression(one.condition)
        to_else = self.e.put(op.JUMP_IF_ZERO, one.place, -1)
        self.statements(one.then)
        to_end = self.e.put(op.JUMP, one.place, 0)
        self.e.land(to_else)
        self.statements(one.otherwise)
        self.e.land(to_end)

    def returns(self, place: Place) -> None:
        self.e.put(op.RETURN, place, 0)

    def modules(self, modules: Sequence[syntax.Module]) -> None:
        for one in modules:
            for argument in one.arguments:
                self.expression(argument)
            arity = len(one.arguments)
            self.e.put(op.EMIT, one.place, -arity, self.e.kind(one.symbol, arity))

    def expression(self, one: syntax.Expression) -> None:
        """Code that leaves the expression's value on the stack; a known value is computed now."""
        hidden = {*self.locals, *self.e.globals, *(name for bound in self.bound for name in bound)}
        visible = {name: macro for name, macro in self.e.macros.items() if name not in hidden}
        value = fold(one, visible, self.e.name)
        if value is None:
            self.compute(one)
        else:
            self.e.constant(value, one.place)

    def compute(self, one: syntax.Expression) -> None:
        if isinstance(one, syntax.Number):
            self.e.constant(one.value, one.place)
        elif isinstance(one, syntax.Name):
            self.named(one)
        elif isinstance(one, syntax.Index):
            if one.name not in self.e.arrays:
                known = ", ".join(self.e.arrays) or "none is defined"
                self.fail(f"there is no array {one.name}", one.place, expected=known, got=one.name)
            self.compute(one.index)
            self.e.put(op.ELEMENT, one.place, 0, self.e.arrays[one.name])
        elif isinstance(one, syntax.Unary):
            self.compute(one.operand)
            self.e.put(op.NEGATE if one.operator == "-" else op.NOT, one.place, 0)
        elif isinstance(one, syntax.Call):
            self.call(one)
        elif one.operator in ("&&", "||"):
            self.shortcut(one)
        else:
            self.compute(one.left)
            self.compute(one.right)
            self.e.put(op.OPERATORS[one.operator], one.place, -1)

    def named(self, one: syntax.Name) -> None:
        if self.bound and one.name in self.bound[-1]:
            argument, bound, macro = self.bound[-1][one.name], self.bound.pop(), self.expanding.pop()
            self.compute(argument)  # in the scope of the macro's caller
            self.bound.append(bound)
            self.expanding.append(macro)
        elif one.name in self.locals:
            self.e.put(op.LOAD, one.place, 1, self.locals[one.name])
        elif one.name in self.e.globals:
            self.e.put(op.LOAD, one.place, 1, self.e.globals[one.name])
        elif one.name in self.e.macros:
            self.expand(syntax.Call(one.name, (), one.place), is_value=True)
        elif one.name in self.e.functions:
            self.e.constant(self.e.functions[one.name], one.place)
        else:
            known = [*self.locals, *(name for name in self.e.globals if name), *self.e.macros]
            expected = ", ".join(known[:12]) or "a number"
            hint = "a parameter of the predecessor, a local variable, or a #define"
            self.fail(f"{one.name} has no value here", one.place, expected=expected, hint=hint)

    def expand(self, one: syntax.Call, *, is_value: bool = False) -> None:
        macro = self.e.macros[one.name]
        parameters = macro.parameters or ()
        if (macro.parameters is None) != is_value or len(parameters) != len(one.arguments):
            wanted = one.name if macro.parameters is None else f"{one.name}({', '.join(parameters)})"
            self.fail(f"{one.name} is defined otherwise", one.place, expected=wanted)
        if one.name in self.expanding:
            self.fail(f"#define {one.name} is made of itself", one.place, got=" > ".join([*self.expanding, one.name]))
        self.expanding.append(one.name)
        self.bound.append(dict(zip(parameters, one.arguments, strict=True)))
        self.compute(macro.body)
        self.bound.pop()
        self.expanding.pop()

    def call(self, one: syntax.Call) -> None:
        if one.name in self.e.macros:
            self.expand(one)
            return
        if one.name == "count":
            self.count(one)
            return
        if one.name not in op.BUILTINS:
            self.fail(f"the function {one.name} is not known", one.place, expected=", ".join([*op.BUILTINS, "count"]))
        operation, arity = op.BUILTINS[one.name]
        if len(one.arguments) != arity:
            self.fail(f"{one.name} takes {arity} argument{'s' * (arity > 1)}", one.place, got=f"{len(one.arguments)}")
        chosen = one.arguments[0]
        if one.name == "func" and isinstance(chosen, syntax.Number) and chosen.value not in self.e.functions.values():
            known = ", ".join(self.e.functions) or "none is defined"
            self.fail(f"there is no function {chosen.value:g}", chosen.place, expected=known)
        for argument in one.arguments:
            self.compute(argument)
        self.e.put(operation, one.place, 1 - arity)

    def count(self, one: syntax.Call) -> None:
        if not self.is_global or len(one.arguments) != 1 or not isinstance(one.arguments[0], _SYMBOL):
            self.fail("count(A) counts modules in Start, StartEach and EndEach", one.place, expected="one symbol in it")
        argument = one.arguments[0]
        if isinstance(argument, syntax.Name) and len(argument.name) > 1:
            self.fail("a symbol is one character", argument.place, expected="count(A)", got=argument.name)
        symbol = argument.name if isinstance(argument, syntax.Name) else f"{argument.value:g}"
        name = f"count({symbol})"
        if name not in self.e.globals:
            self.e.counted.append((len(self.e.globals), symbol))
            self.e.globals[name] = self.e.append_reals([0.0])
        self.e.put(op.LOAD, one.place, 1, self.e.globals[name])

    def shortcut(self, one: syntax.Binary) -> None:
        """The right side runs only if it decides: it may draw."""
        self.compute(one.left)
        self.e.put(op.TRUTH if one.operator == "&&" else op.NOT, one.place, 0)
        skip = self.e.put(op.JUMP_IF_ZERO, one.place, -1)
        self.compute(one.right)
        self.e.put(op.TRUTH, one.place, 0)
        end = self.e.put(op.JUMP, one.place, -1)
        self.e.land(skip)
        self.e.constant(0.0 if one.operator == "&&" else 1.0, one.place)
        self.e.land(end)


def _assigned_in(*blocks: Sequence[syntax.Statement]) -> list[str]:
    """Names that statements may assign, each once, in their order."""
    found: list[str] = []
    for one in (one for block in blocks for one in block):
        if isinstance(one, syntax.Assign):
            found.append(one.name)
        elif isinstance(one, syntax.If):
            found += _assigned_in(one.then, one.otherwise)
    return list(dict.fromkeys(found))


def formals(one: syntax.Production) -> list[tuple[str, Place]]:
    """Names of the parameters before a production's arrow, in their order, with their places."""
    modules = (*one.left, *one.predecessor, *one.right)
    return [(a.name, a.place) for module in modules for a in module.arguments if isinstance(a, syntax.Name)]


def _sampled(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """The curve as a fine polyline: x ascending, and y."""
    control = np.array(points, dtype=np.float64)
    degree = min(3, len(control) - 1)
    if degree == 1:
        return control[:, 0].tolist(), control[:, 1].tolist()
    from scipy.interpolate import BSpline  # late: most programs have no functions

    spans = len(control) - degree
    knots = np.concatenate([np.zeros(degree), np.linspace(0, 1, spans + 1), np.ones(degree)])
    curve = BSpline(knots, control, degree)(np.linspace(0, 1, spans * _SAMPLES_A_SPAN + 1))
    return np.maximum.accumulate(curve[:, 0]).tolist(), curve[:, 1].tolist()


def fold(expression: syntax.Expression, macros: Mapping[str, syntax.Macro], name: str) -> float | None:
    """Value of an expression of numbers and #defines; None where it needs more, draws, or has no value.

    Raises `LsystemError` for a division by zero.
    """
    known: dict[str, float | None] = {}  # each #define is computed once, however often it stands

    def value_of(one: syntax.Expression) -> float | None:
        match one:
            case syntax.Number():
                return one.value
            case syntax.Name():
                macro = macros.get(one.name)
                if macro is None or macro.parameters is not None:
                    return None
                if one.name not in known:
                    known[one.name] = None  # if it is made of itself
                    known[one.name] = value_of(macro.body)
                return known[one.name]
            case syntax.Unary():
                value = value_of(one.operand)
                return None if value is None else (-value if one.operator == "-" else float(not value))
            case syntax.Call():
                arity = len(one.arguments)
                if one.name in macros or one.name not in _FUNCTIONS or arity != op.BUILTINS[one.name][1]:
                    return None
                values = [value for argument in one.arguments if (value := value_of(argument)) is not None]
                return float(_FUNCTIONS[one.name](*values)) if len(values) == arity else None
            case syntax.Binary():
                left = value_of(one.left)
                if one.operator in ("&&", "||") and left is not None and bool(left) == (one.operator == "||"):
                    return float(bool(left))  # the right side never runs
                right = value_of(one.right)
                if one.operator in "/%" and right == 0:
                    fail("division by zero", name, one.place)
                return None if left is None or right is None else float(_OPERATORS[one.operator](left, right))
        return None

    try:
        found = value_of(expression)
    except (OverflowError, ValueError):
        return None  # the VM reports where
    return found if found is None or math.isfinite(found) else None
