"""What follows a keyword -> its value, counted and judged by the keyword's row in the table of words."""

import math
import re
from collections.abc import Sequence
from typing import Any

from lark import Token

from . import foreign
from .lexer import place
from .messages import CLIP, Place, SceneError, Source, quote
from .quantities import Flags, Numbers
from .words import row

PARENTHESES = re.compile(r"[\s:=]*\([-+.\d\s,;e]*\)", re.IGNORECASE)
HTML_COLOR = re.compile(r"[\s:=]*#([0-9a-f]{6})\b", re.IGNORECASE)


def read_value(source: Source, children: Sequence[Token]) -> Any:
    """What follows a keyword, counted and judged by the keyword's row: a number or a tuple."""
    keyword, *rest = children
    takes = row(keyword).takes
    if isinstance(takes, Flags):
        return _flags(source, keyword, rest, takes)
    assert takes is not None
    tokens = [token for token in rest if token.type in ("NUMBER", "BOOL")]
    for token in tokens:
        if token.type == "BOOL":
            raise source.error(place(token), f"found {quote(token)} after {keyword}; expected a number")
    if len(tokens) not in ((1, 3) if takes.channels else (takes.count,)):
        raise _miscounted(source, keyword, tokens, takes)
    value = takes.value([float(token) for token in tokens])
    if value is None:
        for token in tokens:
            _judge(source, keyword, token, takes)
        raise source.error(place(tokens[0]), f"{keyword} has length 0; expected a direction")
    return value


def _judge(source: Source, keyword: Token, token: Token, takes: Numbers) -> None:
    """Raises SceneError for a number that the keyword's row does not allow."""
    value = float(token)
    if not math.isfinite(value):
        raise source.error(place(token), f"found {quote(token)}; expected a finite number")
    if takes.nonzero and value == 0:
        raise source.error(place(token), f"found {quote(token)}; this scale is singular, expected factors other than 0")
    if not takes.allow(value):
        raise source.error(place(token), f"found {quote(token)} after {keyword}; expected {takes.bounds()}")


def _miscounted(source: Source, keyword: Token, tokens: Sequence[Token], takes: Numbers) -> SceneError:
    """The error about a wrong count of numbers."""
    expected = takes.counted()
    rest = source.text[span([keyword, *tokens]).end :]
    if remark := PARENTHESES.match(rest[: 2 * CLIP]):
        written = remark[0].strip(" :=")
        expected += f"; {quote(written)} is a remark, as parentheses are"
        expected += f"; without them: {numbers}" if (numbers := foreign.spaced(written[1:-1])) else ""
    html = HTML_COLOR.match(source.text, span([keyword, *tokens]).end)
    if html:
        values = " ".join(f"{int(html[1][i : i + 2], 16) / 255:.3g}" for i in (0, 2, 4))
        expected += f"; {html[0].strip(' :=')!r} is a remark, and this colour is {values}"
    return source.error(
        span(tokens or [keyword]),
        f"found {len(tokens)} number{'s' * (len(tokens) != 1)} after {keyword}; expected {expected}",
    )


def _flags(source: Source, keyword: Token, values: Sequence[Token], takes: Flags) -> bool | tuple[bool, ...]:
    """TRUE and FALSE, or 1 and 0."""
    for token in values:
        if token.type == "NUMBER" and token not in ("0", "1"):
            raise source.error(place(token), f"found {quote(token)} after {keyword}; expected TRUE or FALSE")
    if len(values) != takes.count:
        words = f"{len(values)} word{'s' * (len(values) != 1)}"
        raise source.error(span([keyword, *values]), f"found {words} after {keyword}; expected {takes.counted()}")
    result = tuple(token == "1" if token.type == "NUMBER" else row(token).name == "true" for token in values)
    return result if takes.count > 1 else result[0]


def span(tokens: Sequence[Token]) -> Place:
    """From the first token to the last."""
    return Place(place(tokens[0]).start, place(tokens[-1]).end)
