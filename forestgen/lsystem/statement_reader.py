"""From the text of one statement to syntax, by the grammar in grammar.lark, which Lark reads (LALR)."""

from __future__ import annotations

import re
from functools import lru_cache
from importlib.resources import files
from typing import Any, NoReturn

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedToken

from forestgen.core.errors import LsystemError
from forestgen.lsystem.syntax import (
    Assign,
    Binary,
    Call,
    Expression,
    If,
    Index,
    Module,
    Name,
    Number,
    Place,
    Production,
    Unary,
    UseGroup,
)
from forestgen.lsystem.syntax import Statement as Instruction

_STARTS = ["production", "words", "word", "string", "expression", "statements", "arrays", "points"]
_PLAIN = {
    "LPAR": "(", "RPAR": ")", "LBRACE": "{", "RBRACE": "}", "LSQUARE": "[", "RSQUARE": "]", "COMMA": ",", "COLON": ":",
    "ARROW": "-->", "BECOMES": "=", "SEMICOLON": ";", "NAME": "a name", "NUMBER": "a number", "SYMBOL": "a module",
    "STAR": "*", "$END": "the end of the statement", "LESS": "<", "GREATER": ">",
}  # fmt: skip
_OPERATORS = {
    "OR", "AND", "EQUAL", "UNEQUAL", "LESS_EQUAL", "GREATER_EQUAL", "PLUS", "MINUS", "SLASH", "PERCENT", "CARET", "NOT",
}  # fmt: skip
_DEEPEST = 200  # parentheses and operators within one another


@lru_cache(maxsize=1)
def _lark() -> Lark:
    grammar = files("forestgen.lsystem").joinpath("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start=_STARTS, maybe_placeholders=True)


class Reader:
    """Turns Lark's trees of one statement into syntax; knows where the statement lies in the file."""

    def __init__(self, name: str, origin: Place) -> None:
        self.name, self.origin = name, origin

    def place(self, line: int, column: int) -> Place:
        """Place in the file of a place in the statement."""
        return Place(self.origin.line + line - 1, column + (self.origin.column - 1 if line == 1 else 0))

    def at(self, token: Token) -> Place:
        return self.place(token.line or 1, token.column or 1)

    def fail(self, problem: str, place: Place, **about: str | None) -> NoReturn:
        raise LsystemError(problem, where=f"{self.name}:{place.line}:{place.column}", **about)

    def parse(self, text: str, start: str) -> Any:
        _refuse_deep(self, text)
        try:
            return _lark().parse(text, start=start)
        except UnexpectedCharacters as error:
            got = repr(text[error.pos_in_stream or 0])
            self.unexpected(self.place(error.line, error.column), error.allowed, got, text)
        except UnexpectedEOF as error:
            lines = text.split("\n")
            self.unexpected(self.place(len(lines), len(lines[-1]) + 1), error.expected, "the end", text)
        except UnexpectedToken as error:
            at_end = error.token.type == "$END"
            lines = text.rstrip().split("\n")
            place = self.place(len(lines), len(lines[-1]) + 1) if at_end else self.at(error.token)
            got = "the end of the statement" if at_end else repr(str(error.token))
            self.unexpected(place, error.accepts or error.expected, got, text)

    def unexpected(self, place: Place, expected: Any, got: str, text: str) -> NoReturn:
        names = set(expected or ())
        shown = [_PLAIN[one] for one in _PLAIN if one in names]
        if names & _OPERATORS:
            shown.append("an operator")
        hint = None
        if "-->" not in text and re.search(r"->|→", text):
            hint = "the arrow of a production is -->"
        elif got.strip("'\"") == "=":
            hint = "equality is =="
        self.fail("this is not understood", place, expected=", ".join(shown) or None, got=got, hint=hint)

    def modules(self, tree: Tree[Token] | None) -> tuple[Module, ...]:
        return () if tree is None else tuple(self.module(one) for one in tree.children if isinstance(one, Tree))

    def module(self, tree: Tree[Token]) -> Module:
        symbol = tree.children[0]
        assert isinstance(symbol, Token)
        if tree.data == "comma":
            return Module(",", (), self.at(symbol))
        arguments = tree.children[2]
        given = arguments.children if isinstance(arguments, Tree) else ()
        return Module(str(symbol), self.expressions(given), self.at(symbol))

    def expressions(self, children: Any) -> tuple[Expression, ...]:
        return tuple(self.expression(one) for one in children if isinstance(one, Tree))

    def expression(self, tree: Any) -> Expression:
        kind, children = tree.data, tree.children
        if kind == "group":
            return self.expression(children[1])
        if kind == "binary":
            left, operator, right = children
            return Binary(str(operator), self.expression(left), self.expression(right), self.at(operator))
        if kind == "unary":
            operand = self.expression(children[1])
            return operand if children[0] == "+" else Unary(str(children[0]), operand, self.at(children[0]))
        first = children[0]
        place = self.at(first)
        if kind == "number":
            return Number(float(first), place)
        if kind == "call":
            given = children[2].children if children[2] is not None else ()
            return Call(str(first), self.expressions(given), place)
        if kind == "index":
            return Index(str(first), self.expression(children[2]), place)
        return Name(str(first), place)

    def instructions(self, trees: Any) -> tuple[Instruction, ...]:
        found = (self.instruction(tree) for tree in trees if isinstance(tree, Tree) and tree.data != "nothing")
        return tuple(found)

    def instruction(self, tree: Tree[Token]) -> Instruction:
        children: Any = tree.children
        place = self.at(children[0])
        if tree.data == "assignment":
            return Assign(str(children[0]), self.expression(children[2]), place)
        if tree.data == "use_group":
            return UseGroup(self.expression(children[2]), place)
        otherwise = children[6] if len(children) > 6 else None
        return If(self.expression(children[2]), self.branch(children[4]), self.branch(otherwise), place)

    def branch(self, tree: Any) -> tuple[Instruction, ...]:
        if tree is None:
            return ()
        inner = tree.children[0]
        return self.instructions(inner.children if inner.data == "block" else [inner])

    def production(self, text: str, group: int) -> Production:
        tree = self.parse(text, "production")
        left, _, pred, _, right, condition, _, successor, _, probability = tree.children
        before, test, after = self.condition(condition)
        return Production(
            left=self.modules(left.children[0]) if left and isinstance(left.children[0], Tree) else (),
            predecessor=self.modules(pred),
            right=self.modules(right.children[0]) if right and isinstance(right.children[0], Tree) else (),
            before=before,
            condition=test,
            after=after,
            successor=self.modules(successor),
            probability=None if probability is None else self.expression(probability),
            place=self.module(pred.children[0]).place,
            group=group,
        )

    def condition(self, tree: Any) -> tuple[tuple[Instruction, ...], Expression | None, tuple[Instruction, ...]]:
        if tree is None:
            return (), None, ()
        before: tuple[Instruction, ...] = ()
        after: tuple[Instruction, ...] = ()
        test = None
        seen_test = False
        for child in tree.children:
            if not isinstance(child, Tree):
                continue
            if child.data == "test":
                seen_test = True
                test = self.expression(child.children[0]) if isinstance(child.children[0], Tree) else None
            elif seen_test:
                after = self.instructions(child.children)
            else:
                before = self.instructions(child.children)
        return before, test, after


def is_tree(tree: Any) -> bool:
    return bool(tree.children) and isinstance(tree.children[0], Tree)


def _refuse_deep(reader: Reader, text: str) -> None:
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth > _DEEPEST:
            line = text.count("\n", 0, position) + 1
            place = reader.place(line, position - text.rfind("\n", 0, position))
            reader.fail("parentheses lie too deep within one another", place, expected=f"at most {_DEEPEST}")
