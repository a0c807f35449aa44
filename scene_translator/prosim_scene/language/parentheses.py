"""Trees that are written as in other languages: with parentheses, which are remarks here, or infix."""

import re

from lark import Token, Tree

from .lexer import place
from .messages import Source
from .words import STATEMENTS, of_role

SOLID = "(?:" + "|".join(spelling for row in of_role("PRIMITIVE") for spelling in row.spellings) + r")\s+\d+"
PREFIX = re.compile(SOLID, re.IGNORECASE)
INFIX = re.compile(rf"{SOLID}[^()+*-]*\)*\s*[+*-]\s*\(*\s*{SOLID}", re.IGNORECASE)
EXPLAINED = "operators come before their operands, as in - CUBE 1 SPHERE 2, and parentheses are remarks"


def judge(source: Source, pieces: list[Token], tree: Tree[Token]) -> None:
    """Raises an error or has a doubt where remarks in CSG-TREE hold what looks like the tree."""
    remarks = in_tree(pieces)
    empty = any(isinstance(s, Tree) and s.data == "csg" and len(s.children) == 1 for s in tree.children)
    for remark in remarks:
        if empty and PREFIX.search(remark):
            raise source.error(place(remark), f"the tree stands in a remark: {EXPLAINED}")
        if INFIX.search(remark):
            source.doubt(place(remark), f"this remark reads like a part of the tree: {EXPLAINED}")


def infix(source: Source, items: list[Tree[Token]]) -> str | None:
    """A tree that is written infix, A - B * C, as the language writes it: - A * B C; None for any other.

    ``items``: the operators and leaves of CSG-TREE. Products go first, as everywhere.
    """
    if len(items) < 3 or [item.data for item in items] != ["leaf", "operator"] * (len(items) // 2) + ["leaf"]:
        return None
    operators = [str(item.children[0]) for item in items[1::2]]
    leaves = [" ".join(source.text[place(t).start : place(t).end] for t in _tokens(item)) for item in items[::2]]
    for products in (True, False):
        rest, others = leaves[:1], []
        for operator, leaf in zip(operators, leaves[1:]):
            if (operator == "*") == products:
                rest[-1] = f"{operator} {rest[-1]} {leaf}"
            else:
                rest.append(leaf)
                others.append(operator)
        leaves, operators = rest, others
    return leaves[0]


def _tokens(item: Tree[Token]) -> list[Token]:
    return [child for child in item.children if isinstance(child, Token)]


def in_tree(pieces: list[Token]) -> list[Token]:
    """The remarks in parentheses within CSG-TREE that name a primitive and its index."""
    remarks, inside = [], False
    for piece in pieces:
        if piece.type in STATEMENTS:
            inside = piece.type == "CSG_TREE"
        elif inside and piece.type == "REMARK" and piece.startswith("(") and PREFIX.search(piece):
            remarks.append(piece)
    return remarks
