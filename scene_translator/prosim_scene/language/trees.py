"""CSG-TREE, read at one go where it is complete and nothing is unusual in it; ``units.read`` reads the others."""

import re
from functools import cache, lru_cache

from lark import Token

from ..model import Leaf, Operator, Texture
from . import foreign
from .automaton import Parser
from .builder import texture
from .lexer import terminal
from .messages import Place, Source
from .parentheses import PREFIX
from .units import Unit
from .words import OPERATORS, ROWS, STATEMENTS, fold, spelled

OPENING = re.compile(spelled("CSG_TREE"), re.IGNORECASE | re.ASCII)
#: An operator; a primitive, its index and texture slots; or a remark.
NODE = re.compile(
    rf"\s*(?:([+*-])(?![\d.]|inf|nan)|({spelled('PRIMITIVE')})[\s:=]+(\d{{1,9}})(?![^\s()#\":=])"
    rf"((?:\s+(?:{spelled('NULL')}|t-[^\s()#\":=]+|[^\s()#\":={{}}$*+-][^\s()#\":={{}}]*\.[^\s()#\":=]+))*)"
    r"|(\#[^\n]*|\([^()]*\)))",
    re.IGNORECASE,
)
KEYWORD = re.compile(spelled(*STATEMENTS), re.IGNORECASE | re.ASCII)
SPACE = re.compile(r"\s*")
OPERATOR = {symbol: Operator(symbol) for symbol in OPERATORS}
Slots = tuple[Texture | None, Texture | None]
NO_TEXTURES: Slots = (None, None)


def read(source: Source, start: int) -> Unit | None:
    """The tree that begins at ``start``, if it is right and as usual."""
    text = source.text
    opening = OPENING.match(text, start)
    if opening is None:
        return None
    position, missing = opening.end(), 1
    nodes: list[Operator | Leaf] = []
    places: list[Place] = []
    for found in NODE.finditer(text, position):
        if found.start() != position:
            break
        position = found.end()
        operator, word, index, words, remark = found.groups()
        if remark:
            if PREFIX.search(remark) or foreign.remark(remark):
                return None  # there is something to be said of it, if it was meant as a part of the tree
            continue
        if not missing:
            return None
        places.append(Place(found.start(1 if operator else 2), position))
        if operator:
            missing += 1
            nodes.append(OPERATOR[operator])
            continue
        missing -= 1
        shape, slots = _shape(word), _slots(words) if words else NO_TEXTURES
        if shape is None or slots is None:
            return None
        nodes.append(Leaf(shape, int(index), slots))
    space = SPACE.match(text, position)
    end = space.end() if space else position
    if missing or not KEYWORD.match(text, end):
        return None
    fields = {"csg": tuple(nodes)}
    return Unit(start, end, "CSG_TREE", opening.end() - start, ("csg",), fields, text=text[start:end], nodes=places)


@lru_cache(maxsize=1 << 10)
def _slots(words: str) -> Slots | None:
    """What stands in the texture slots; None where it is wrong."""
    textures = []
    for word in words.split():
        kind = terminal(word, _after_index(), "CSG_TREE")
        if kind not in ("TEXTURE_NAME", "FILE", "NULL"):
            return None
        textures.append(texture(kind, word))
    return (textures[0], textures[1] if len(textures) > 1 else None) if len(textures) <= 2 else None


@cache
def _after_index() -> frozenset[str]:
    """The terminals that have a place after a primitive and its index."""
    parser = Parser()
    for kind in ("CSG_TREE", "PRIMITIVE", "NUMBER"):
        parser.feed_token(Token(kind, ""))
    return parser.choices()


@lru_cache(maxsize=1 << 10)
def _shape(word: str) -> str | None:
    """The shape that a primitive's word names."""
    return next((row.name for row in ROWS.get(fold(word), ()) if row.role == "PRIMITIVE"), None)
