"""Arithmetic in braces -> a number.

The parser is lark's LALR with expression.lark. The tree is worked through from its leaves up, in a loop, so that no
input can exhaust Python's stack.
"""

import math
import operator
from collections.abc import Callable
from functools import cache
from pathlib import Path

from lark import Lark, Token, Tree, UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from .diagnostics import SceneError, Source, Span, listing, quote
from .suggestions import nearest, of_braces


def _quarters(degrees: float) -> int | None:
    """How many right angles an angle has, 0 to 3; None where it is between two."""
    return int(degrees // 90) % 4 if degrees % 90 == 0 else None


def _cosine(degrees: float) -> float:
    quarters = _quarters(degrees)
    return math.cos(math.radians(math.fmod(degrees, 360))) if quarters is None else (1.0, 0.0, -1.0, 0.0)[quarters]


def _sine(degrees: float) -> float:
    quarters = _quarters(degrees)
    return math.sin(math.radians(math.fmod(degrees, 360))) if quarters is None else (0.0, 1.0, 0.0, -1.0)[quarters]


def _tangent(degrees: float) -> float:
    return _sine(degrees) / _cosine(degrees)


#: Name -> (the function, the least and the most numbers that it takes; None: any number). Angles are in degrees, and
#: right angles are exact.
FUNCTIONS: dict[str, tuple[Callable[..., float], int, int | None]] = {
    "sin": (_sine, 1, 1),
    "cos": (_cosine, 1, 1),
    "tan": (_tangent, 1, 1),
    "atan2": (lambda y, x: math.degrees(math.atan2(y, x)), 2, 2),
    "sqrt": (math.sqrt, 1, 1),
    "abs": (abs, 1, 1),
    "floor": (math.floor, 1, 1),
    "round": (lambda x: math.floor(x + 0.5), 1, 1),
    "mod": (operator.mod, 2, 2),
    "min": (min, 2, None),
    "max": (max, 2, None),
}
CONSTANTS = {"pi": math.pi}
OPERATIONS: dict[str, Callable[..., float]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "negate": operator.neg,
    "power": math.pow,
}


def evaluate(source: Source, braces: Span, value: Callable[[str, Span], float]) -> float:
    """The number that an expression comes to; ``braces`` is its span, these included.

    ``value(name, span)`` says what a name stands for. Raises SceneError, also where the result is not finite.
    """
    first = braces.start + 1
    if source.text[braces.end - 1] != "}":
        reason = of_braces(source.text[first : braces.end])
        raise _error(source, braces, "this '{' is not closed on its line" + (f"; {reason}" if reason else ""))
    try:
        tree = _parser().parse(source.text[first : braces.end - 1])
    except UnexpectedInput as error:
        raise _syntax_error(source, braces, error) from None
    values: dict[int, float] = {}
    for node in tree.iter_subtrees():  # the leaves first
        span = Span(first + node.meta.start_pos, first + node.meta.end_pos)
        values[id(node)] = _value(source, node, span, values, value)
    return values[id(tree)]


@cache
def _parser() -> Lark:
    grammar = Path(__file__).with_name("expression.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start="sum", propagate_positions=True)


def _value(
    source: Source, node: Tree[Token], span: Span, values: dict[int, float], value: Callable[[str, Span], float]
) -> float:
    """The value of a node, whose operands have theirs in ``values``."""
    word = str(node.children[0]) if node.children and isinstance(node.children[0], Token) else ""
    operands = [values[id(child)] for child in node.children if isinstance(child, Tree)]
    if node.data == "number":
        result = float(word)
    elif node.data == "name":
        result = value(word[1:], span)
    elif node.data == "word":
        if word not in CONSTANTS:
            raise _unknown(source, span, word)
        result = CONSTANTS[word]
    else:
        function = _function(source, span, word, len(operands)) if node.data == "call" else OPERATIONS[node.data]
        try:
            result = float(function(*operands))
        except ZeroDivisionError:
            raise _error(source, span, "this divides by 0") from None
        except (ValueError, OverflowError):
            result = math.nan
    if not math.isfinite(result):
        raise _error(source, span, f"{quote(source.text[span.start : span.end])} is no finite number")
    return result


def _function(source: Source, span: Span, word: str, count: int) -> Callable[..., float]:
    """The function of that name, for so many numbers."""
    if word not in FUNCTIONS:
        raise _unknown(source, span, word)
    function, least, most = FUNCTIONS[word]
    if count < least or (most is not None and count > most):
        raise _error(
            source,
            span,
            f"found {count} number{'s' * (count != 1)} in {word}(); expected {least}{' or more' * (most is None)}",
        )
    return function


def _unknown(source: Source, span: Span, word: str) -> SceneError:
    known = [f"{name}()" for name in FUNCTIONS] + list(CONSTANTS)
    return _error(
        source,
        Span(span.start, span.start + len(word)),
        f"unknown word {quote(word)} in an expression; expected a name such as ${word}, or {listing(known)}"
        f"{nearest(word, [*FUNCTIONS, *CONSTANTS])}",
    )


def _syntax_error(source: Source, braces: Span, error: UnexpectedInput) -> SceneError:
    inside = source.text[braces.start + 1 : braces.end - 1]
    if inside.strip() and (reason := of_braces(inside)):
        return _error(source, braces, f"found {quote(inside.strip())} in braces; {reason}")
    start = braces.start + 1 + (error.pos_in_stream or 0)
    if "NUMBER" in _expected(error):
        wanted = "a number, a $name, a function or '('"
    else:
        wanted = "an operator (+ - * / ^)" + " or ')'" * ("RPAR" in _expected(error))
    if isinstance(error, UnexpectedToken) and error.token.type == "$END":
        unclosed = ""
        if "RPAR" in _expected(error):
            line, column = source.line_column(braces.start + 1 + _open(inside))
            unclosed = f"; the '(' on line {line}, column {column} is not closed"
        return _error(
            source,
            Span(braces.end - 1, braces.end),
            f"the expression ends here and is not complete; expected {wanted}{unclosed}",
        )
    length = 1 if isinstance(error, UnexpectedCharacters) else len(str(getattr(error, "token", " ")))
    span = Span(start, start + length)
    found = source.text[span.start : span.end]
    point = "; a fraction has a point, as in 0.5" if found == "," else ""
    return _error(source, span, f"found {quote(found)} in an expression; expected {wanted}{point}")


def _error(source: Source, span: Span, reason: str) -> SceneError:
    return source.error(span, reason, "expression")


def _open(text: str) -> int:
    """Where the innermost parenthesis is that is open at the end of a text which has one."""
    depth = 0
    for i in range(len(text) - 1, -1, -1):
        depth += {"(": 1, ")": -1}.get(text[i], 0)
        if depth > 0:
            return i
    raise ValueError("no parenthesis is open")


def _expected(error: UnexpectedInput) -> set[str]:
    """The terminals that have a place where the error is."""
    return set(getattr(error, "accepts", None) or getattr(error, "allowed", None) or ())
