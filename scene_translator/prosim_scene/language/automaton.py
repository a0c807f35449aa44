"""grammar.lark -> a parser that is fed token by token.

The tables are those of lark's LALR. The parser keeps its own stack, so that no input can exhaust Python's.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from lark import Lark, Token, Tree, UnexpectedToken
from lark.parsers.lalr_analysis import Shift


class Reduction(NamedTuple):
    """What a rule does: how many values it takes, what it makes of them, and the name of that."""

    size: int
    make: Callable[[list[Any]], Any]
    name: str


class _Tables(NamedTuple):
    """Of each state, at each terminal, the state to go to, or how to reduce; at each name the state to go to; and the
    terminals alone.
    """

    shifts: dict[int, dict[str, int]]
    reductions: dict[int, dict[str, Reduction]]
    terminals: dict[int, frozenset[str]]
    start: int
    end: int


@cache
def _tables() -> _Tables:
    grammar = Path(__file__).with_name("grammar.lark").read_text(encoding="utf-8")
    lark = Lark(grammar, parser="lalr").parse_interactive().parser_state.parse_conf
    shifts: dict[int, dict[str, int]] = {}
    reductions: dict[int, dict[str, Reduction]] = {}
    for state, row in lark.states.items():
        shifts[state] = {str(name): to for name, (kind, to) in row.items() if kind is Shift}
        reductions[state] = {
            str(name): Reduction(len(rule.expansion), lark.callbacks[rule], str(rule.origin.name))
            for name, (kind, rule) in row.items()
            if kind is not Shift
        }
    terminals = {state: frozenset(str(name) for name in row if name.isupper()) for state, row in lark.states.items()}
    return _Tables(shifts, reductions, terminals, lark.start_state, lark.end_state)


class Parser:
    """A parser at the beginning of a scene, or of a statement, to be fed token by token.

    lark's own one does the same with the same tables, and takes twice the time.
    """

    def __init__(self) -> None:
        self._tables = _tables()
        self._states: list[int] = [self._tables.start]
        self._values: list[Any] = []

    def choices(self) -> frozenset[str]:
        """The terminals for which there is something to do; with some of them only rules end, and nothing begins."""
        return self._tables.terminals[self._states[-1]]

    def accepts(self) -> set[str]:
        """The terminals that have a place here."""
        return {name for name in self.choices() if self._leads_on(name)}

    def _leads_on(self, name: str) -> bool:
        shifts, reductions, states = self._tables.shifts, self._tables.reductions, self._states.copy()
        while states[-1] != self._tables.end and name not in shifts[states[-1]]:
            if (rule := reductions[states[-1]].get(name)) is None:
                return False
            del states[len(states) - rule.size :]
            states.append(shifts[states[-1]][rule.name])
        return True

    def feed_token(self, token: Token) -> None:
        """Takes a token; raises UnexpectedToken where it has no place."""
        name, states, values = token.type, self._states, self._values
        shifts, reductions, end = self._tables.shifts, self._tables.reductions, self._tables.end
        while (to := shifts[states[-1]].get(name)) is None:
            if (rule := reductions[states[-1]].get(name)) is None:
                raise UnexpectedToken(token, set(self.choices()))
            size, make, made = rule
            parts: list[Any] = []
            if size:
                parts = values[-size:]
                del states[-size:], values[-size:]
            values.append(make(parts))
            states.append(shifts[states[-1]][made])
            if states[-1] == end:
                return
        states.append(to)
        values.append(token)

    def feed_eof(self) -> Tree[Token]:
        """The tree of all tokens; raises UnexpectedToken where more are expected."""
        self.feed_token(Token("$END", "", 0))
        tree: Tree[Token] = self._values[-1]
        return tree
