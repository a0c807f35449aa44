"""Computes the values of ``$names`` and of arithmetic expressions in braces.

The parser generator lark (LALR) parses the expressions by the grammar in the file expression.lark. A loop evaluates the
syntax tree from its leaves up, so a deeply nested expression does not exceed Python's recursion limit.
"""

import math
import operator
import re
from collections import ChainMap
from collections.abc import Callable, Mapping
from functools import cache
from numbers import Real
from pathlib import Path

from lark import Lark, Token, Tree, UnexpectedInput

from .diagnostics import MAX_ERRORS, SceneError, Source, Span, listing, quote
from .suggestions import BRACES, NUMBER, nearest

#: Matches a name without its ``$``.
NAME = re.compile(r"[^\W\d]\w*")
#: The predefined names: the number of a frame of an animation, and the time of this frame in seconds.
FRAME, TIME = "frame", "time"
#: The default number of frames per second, as in cinema.
FPS = 24.0
#: The largest number of characters of an expression: more would take seconds.
MAX_LENGTH = 10_000


def _in_degrees(function: Callable[[float], float], exact: tuple[float, ...]) -> Callable[[float], float]:
    """Converts a ``function`` of radians into one of degrees, with ``exact`` values at 0, 90, 180 and 270 degrees."""
    return lambda x: exact[int(x // 90) % 4] if x % 90 == 0 else function(math.radians(math.fmod(x, 360)))


_sine, _cosine = _in_degrees(math.sin, (0.0, 1.0, 0.0, -1.0)), _in_degrees(math.cos, (1.0, 0.0, -1.0, 0.0))
#: Name of a function -> (the function, the number of its arguments; 0: two or more). Angles are in degrees.
FUNCTIONS: dict[str, tuple[Callable[..., float], int]] = {
    "sin": (_sine, 1),
    "cos": (_cosine, 1),
    "tan": (lambda x: _sine(x) / _cosine(x), 1),
    "atan2": (lambda y, x: math.degrees(math.atan2(y, x)), 2),
    "sqrt": (math.sqrt, 1),
    "abs": (abs, 1),
    "floor": (math.floor, 1),
    "round": (lambda x: math.floor(x + 0.5), 1),
    "mod": (operator.mod, 2),
    "min": (min, 0),
    "max": (max, 0),
}
CONSTANTS = {"pi": math.pi}


def number_text(value: float) -> str:
    """Returns the text of a number in the syntax of the scene language, without loss of precision."""
    return str(int(value)) if abs(value) < 1e15 and value == int(value) else repr(value)


class Definitions:
    """The values of ``$names``: the caller's (``-D``, ``define``), else of the DEFAULT above its use; ``$frame`` and
    ``$time`` are predefined. ``uses`` are the names that the text uses.
    """

    def __init__(self, source: Source, given: Mapping[str, object] | None = None) -> None:
        """Raises SceneError if ``given``, by the caller, has a name or value that is not allowed."""
        self.source = source
        self.caller_values = {name: _caller_value_text(source, name, value) for name, value in (given or {}).items()}
        self.defaults: dict[str, str] = {}
        self.values = ChainMap(self.caller_values, self.defaults, {FRAME: "0"})
        self.uses: set[str] = set()
        self.undefined: dict[str, SceneError] = {}  # name -> the error about it, for at most MAX_ERRORS names
        source.names.update({name: f"{quote(text)}, by -D {name}={text}" for name, text in self.caller_values.items()})

    def set_default(self, name: str, text: str) -> None:
        """Stores the value of a DEFAULT statement, unless the caller has set one."""
        self.defaults[name] = text
        self.source.names.setdefault(name, quote(text))

    def value_text(self, name: str, span: Span) -> str | None:
        """Returns the value of a ``$name`` as text, or None with an error at ``span`` at its first use. ``$time`` is
        ``$frame`` / FPS unless it is set.
        """
        self.uses.add(name)
        if name in self.values:
            return self.values[name]
        if name == TIME:
            return number_text(self.number(FRAME, span) / FPS)
        if name not in self.undefined and len(self.undefined) <= MAX_ERRORS:
            known = [f"${other}" for other in dict.fromkeys([*self.caller_values, *self.defaults, FRAME, TIME])]
            reason = f"${name} has no value; expected DEFAULT ${name} = 1 above its use, -D {name}=1, or "
            reason += f"define={{{name!r}: 1}} in Python{nearest('$' + name, known)}"
            self.undefined[name] = self.source.error(span, reason, "undefined")
        return None

    def number(self, name: str, span: Span) -> float:
        """Returns the value of a name as a number, or NaN if the name has no value.

        Raises SceneError if the value is not a finite number.
        """
        text = self.value_text(name, span)
        if text is None:
            return math.nan
        if not re.fullmatch(NUMBER, text) or not math.isfinite(float(text)):
            raise self.source.error(span, "expected a finite number in arithmetic", "expression")
        return float(text)

    def check_uses(self) -> None:
        """After the whole text, raises SceneError for an unused definition."""
        for name, text in self.caller_values.items():
            if name not in self.uses | self.defaults.keys():
                used = [f"${other}" for other in sorted(self.uses | self.defaults.keys())]
                names = f"it has {listing(used, 'and')}{nearest('$' + name, used)}" if used else "it uses no $names"
                reason = f"the scene does not use ${name}, which -D {name}={text} or define sets; {names}"
                raise SceneError(reason, self.source.filename, "unused-definition")


def _caller_value_text(source: Source, name: str, value: object) -> str:
    """Converts a value that the caller sets for a name to text; raises SceneError if the language does not allow the
    name or the value. True and False become TRUE and FALSE.
    """
    text = value.strip() if isinstance(value, str) else ""
    if isinstance(value, bool):
        text = str(value).upper()
    elif isinstance(value, Real) and math.isfinite(value):
        text = number_text(float(value))
    if not NAME.fullmatch(name):
        reason = f"{name!r} cannot be a name; expected letters, digits and _, such as angle_2"
    elif not text or '"' in text or not text.isprintable():
        reason = f"{name} = {value!r} is not a value; expected a finite number or a word"
    else:
        return text
    raise SceneError(reason, source.filename, "name")


def evaluate(source: Source, braces: Span, definitions: Definitions) -> float:
    """Computes the expression in ``braces``; NaN if a name has no value. Raises SceneError for wrong syntax, unknown
    words, wrong arguments, more than MAX_LENGTH characters, and values that are not finite.
    """
    first, inside = braces.start + 1, source.text[braces.start + 1 : braces.end - 1]
    if len(inside) > MAX_LENGTH:
        raise source.error(braces, f"this expression is longer than {MAX_LENGTH} characters; use names", "expression")
    if source.text[braces.end - 1] != "}":
        raise source.error(braces, f"this '{{' is not closed on its line; {BRACES}", "expression")
    try:
        tree = _parser().parse(inside)
    except UnexpectedInput as error:
        raise _syntax_error(source, braces, error) from None
    values: dict[int, float] = {}
    for node in tree.iter_subtrees():  # visits the leaves first
        span = Span(first + node.meta.start_pos, first + node.meta.end_pos)
        operands = [values[id(child)] for child in node.children if isinstance(child, Tree)]
        values[id(node)] = _value(source, node, span, operands, definitions)
    return values[id(tree)]


@cache
def _parser() -> Lark:
    grammar = Path(__file__).with_name("expression.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start="sum", propagate_positions=True)


def _value(source: Source, node: Tree[Token], span: Span, operands: list[float], definitions: Definitions) -> float:
    """Computes a node from its operands; NaN if one of them is, or if the node is a name without a value."""
    word = str(node.children[0]) if isinstance(node.children[0], Token) else ""
    if node.data == "name":
        return definitions.number(word[1:], span)
    call = node.data == "call"
    if (call or node.data == "word") and word not in (FUNCTIONS if call else CONSTANTS):
        known = listing([*(f"{name}()" for name in FUNCTIONS), *CONSTANTS])
        reason = f"unknown word {quote(word)} in an expression; expected a name such as ${word}, or {known}"
        word_span = Span(span.start, span.start + len(word))
        raise source.error(word_span, reason + nearest(word, [*FUNCTIONS, *CONSTANTS]), "expression")
    given_count = len(operands)
    function, count = FUNCTIONS[word] if call else (_operation(node.data), given_count)
    if given_count != count and (count or given_count < 2):
        reason = f"found {given_count} number{'s' * (given_count != 1)} in {word}(); expected {count or '2 or more'}"
        raise source.error(span, reason, "expression")
    if any(map(math.isnan, operands)):
        return math.nan
    try:  # a node without operands is a constant or a number
        result = float(function(*operands) if operands else CONSTANTS.get(word) or float(word))
    except ZeroDivisionError:
        raise source.error(span, "this divides by 0", "expression") from None
    except (ValueError, OverflowError):
        result = math.nan
    if not math.isfinite(result):
        raise source.error(span, f"{quote(source.text[slice(*span)])} is not a finite number", "expression")
    return result


def _operation(name: str) -> Callable[..., float]:
    return math.pow if name == "power" else getattr(operator, name, float)


def _syntax_error(source: Source, braces: Span, error: UnexpectedInput) -> SceneError:
    # The errors of lark about a token and about a character have different attributes.
    expected = set(getattr(error, "accepts", None) or getattr(error, "allowed", None) or ())
    operators = "an operator (+ - * / ^)" + " or ')'" * ("RPAR" in expected)
    expected_text = "a number, a $name, a function or '('" if "NUMBER" in expected else operators
    token = getattr(error, "token", None)
    if token is not None and token.type == "$END":
        reason = f"the expression ends here and is not complete; expected {expected_text}"
        return source.error(Span(braces.end - 1, braces.end), reason, "expression")
    start = braces.start + 1 + (error.pos_in_stream or 0)
    span = Span(start, start + len(token or " "))
    found = source.text[slice(*span)]
    hint = "a decimal number has a point, as in 0.5" if found == "," else BRACES
    reason = f"found {quote(found)} in an expression; expected {expected_text}; {hint}"
    return source.error(span, reason, "expression")
