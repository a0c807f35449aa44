"""Tokens -> lark's tree, and what is said of a token that has no place where it stands."""

import itertools
import re

from lark import Token, Tree, UnexpectedToken

from . import foreign, lexer
from .automaton import Parser
from .definitions import Definitions
from .hints import TEXTURES, hint, hint_within, meant, nearest, unknown_name
from .messages import CLIP, Place, SceneError, Source, listing, quote
from .quantities import Numbers
from .words import OPERATORS, ROLES, STATEMENT_OF, STATEMENTS, canonical, fold, is_statement, meanings, row

#: The order in which a message lists what it expected.
ORDER = ("NUMBER", "VARIABLE", *OPERATORS.values(), *ROLES, "TEXTURE_NAME", "FILE", "STRING", "WORD", "LPAR", "RPAR")
#: Numbers as other languages write them. A comma is not read: in 0,5 it may be a point, or stand between two numbers.
SEPARATED = re.compile(r"[-+.e\d]*[,;][-+.e\d,;]*", re.IGNORECASE)
#: Sizes as they are written elsewhere: 320x240.
BY_SIGN = re.compile("[x×]", re.IGNORECASE)
BY = re.compile(r"[-+.\d]+([x×][-+.\d]+)+", re.IGNORECASE)
#: An operator, but for the sign of a number or of its exponent.
ARITHMETIC = re.compile(r"[*/^$]|^[-+]$|(?<=[\d.])[-+]")
BRACES = "; arithmetic stands in braces, as in {360 * $frame / 48}"
LIGHT = "; a light begins with AREA or POINT, as in POINT position 0 20 10 SPOT"


def tokens_and_tree(source: Source, definitions: Definitions) -> tuple[list[Token], Tree[Token]]:
    """All pieces of the text in order (tokens and remarks), and lark's tree; raises SceneError."""
    parser = Parser()
    pieces: list[Token] = []
    try:
        for piece in lexer.lex(source, parser.choices, definitions):
            pieces.append(piece)
            if piece.type not in ("REMARK", "REST"):
                parser.feed_token(piece)
        tree = parser.feed_eof()
    except UnexpectedToken as error:
        raise syntax_error(source, error.token, parser.accepts(), pieces) from None
    return pieces, tree


def syntax_error(source: Source, token: Token, expected: set[str], pieces: list[Token]) -> SceneError:
    """The error about a token that has no place after ``pieces``, of which it is the last; ``expected``: what has."""
    inner = [role for role in ORDER if role in expected and role not in STATEMENTS]
    names = [name for role in inner for name in meanings(role)]
    if expected & STATEMENTS:
        names.append("the next statement" if inner else "END" if expected == {"END"} else "a statement")
    if token.type == "$END":
        tokens = [p for p in pieces if p.type != "REMARK"]
        place = lexer.place(tokens[-1]) if tokens else Place(0, 0)
        if "END" in expected:
            return source.error(place, "the file ends here and END is missing; expected END as the last statement")
        return source.error(place, f"the file ends after this; expected {listing(names)}")
    *_, role, name, _ = [Token("", ""), Token("", ""), *(piece for piece in pieces if piece.type != "REMARK")]
    if name.type == "WORD" and (unknown := unknown_name(role.type, name)):
        return source.error(lexer.place(name), unknown)
    return source.error(lexer.place(token), _reason(source, token, expected, pieces, listing(names)))


def _reason(source: Source, token: Token, expected: set[str], pieces: list[Token], names: str) -> str:
    """What is said of a token; ``names``: what has a place where it stands."""
    found = f"found {quote(token)}"
    if said := foreign.word(source.text, lexer.place(token).start, token):
        return f"{found}; {said}"
    if token.type == "EQUALS":
        return f"{found}, which may only follow a keyword"
    if mistake := _mistake(token, expected, pieces):
        return found + mistake
    if named := _named(source, token, pieces):
        return f"{found} after a name; expected one word, or more in quotes: {named}"
    lacking = _lacking(pieces)
    if token.type == "WORD":
        fitting = expected & {"BOOL"} if lacking else expected
        near = BRACES if lacking and ARITHMETIC.search(token) else meant(token, fitting, _within(pieces))
        return f"unknown word {quote(token)}{lacking or f'; expected {names}'}{near}"
    return found + (lacking or _unclosed(source, expected, pieces) or _misplaced(token, expected, pieces, names))


def _misplaced(token: Token, expected: set[str], pieces: list[Token], names: str) -> str:
    """What is said after ``found`` of a word that has its place elsewhere, or of a number."""
    if token.type == "NUMBER" and [piece.type for piece in pieces[-2:-1]] == ["DIELECTRIC"]:
        return f"; expected a glass's name, or n-refr = {quote(token)[1:-1]}"
    if "TEXTURE_NAME" in expected and (near := nearest(token, TEXTURES)):
        return f", the kind of a texture; expected the name of one{near}"
    owner = STATEMENT_OF.get(token.type)
    if owner and owner != _statement(pieces):
        owner = canonical(owner)
        if here := hint_within(token, _within(pieces)):
            return f", a word of {owner}{here}"
        return f", a word of {owner}; expected it after {owner}, before any other statement"
    if token.type in ROLES and token.type not in STATEMENTS and "NUMBER" not in expected:
        return f", which has no place here; expected {names}{LIGHT if 'LIGHT' in expected else hint(token)}"
    return f"; expected {names}"


def _mistake(token: Token, expected: set[str], pieces: list[Token]) -> str:
    """What to say of a token that most likely was meant as a number, or as a name; nothing of others."""
    if expected == {"VARIABLE"}:
        return "; expected a name, such as $angle"
    if "NUMBER" not in expected or token.type not in (*OPERATORS.values(), "WORD"):
        return ""
    braces = BRACES if ARITHMETIC.search(token) else ""
    if braces and [piece.type for piece in pieces[-2:-1]] == ["NUMBER"]:
        return f" after a number{braces}"
    if fold(token.lstrip("+-")) in ("nan", "inf", "infinity"):
        return "; expected a finite number"
    if BY.fullmatch(token):
        return f"; expected numbers with nothing but spaces between them: {' '.join(BY_SIGN.split(token))}"
    if SEPARATED.fullmatch(token):
        return (
            "; expected numbers with nothing but spaces between them, as in 1 2 3, and with a point for the fraction, "
            "as in 0.5"
        )
    return f", which is not a number{braces}" if token.type == "WORD" and token[0] in "0123456789.+-" else ""


def _lacking(pieces: list[Token]) -> str:
    """After which keyword the last token stands, and what is still lacking there; nothing elsewhere."""
    before = [piece for piece in pieces[:-1] if piece.type not in ("REMARK", "LPAR")]
    given = 0
    while before and before[-1].type in ("NUMBER", "BOOL"):
        before.pop()
        given += 1
    takes = row(before[-1]).takes if before and before[-1].type in ROLES else None
    one = isinstance(takes, Numbers) and takes.channels and given < 2
    if takes is None or given >= (1 if one else takes.count):
        return ""
    return f" after {before[-1]}; expected {takes.counted()}"


def _unclosed(source: Source, expected: set[str], pieces: list[Token]) -> str:
    """What is said after ``found`` of what stands where a parenthesis should have been closed; nothing elsewhere."""
    if "RPAR" not in expected:
        return ""
    line, column = source.line_column(next(lexer.place(p).start for p in reversed(pieces) if p.type == "LPAR"))
    return f"; expected ')' before it: the '(' on line {line}, column {column} is not closed"


def _named(source: Source, token: Token, pieces: list[Token]) -> str:
    """NAME and all the words on its line, in quotes, where the last token may be one of them; nothing elsewhere."""
    words = [piece for piece in pieces if piece.type != "REMARK"]
    begin = next((i for i in range(len(words) - 1, max(len(words) - 5, -1), -1) if words[i].type == "NAME"), None)
    if token.type != "WORD" or begin is None or begin + 2 >= len(words):
        return ""
    start, here = lexer.place(words[begin + 1]).start, lexer.place(token)
    if "\n" in source.text[start : here.start]:
        return ""
    line = re.split(r'[\n"#()]', source.text[here.end : here.end + CLIP], maxsplit=1)[0].split()
    more = itertools.takewhile(lambda word: not (word.isupper() and is_statement(word)), line)
    return f'NAME "{" ".join([*source.text[start : here.end].split(), *more])}"'


def _within(pieces: list[Token]) -> str:
    """The name of the statement that the last piece stands in; empty before the first."""
    return next((row(piece).name for piece in reversed(pieces[:-1]) if piece.type in STATEMENTS), "")


def _statement(pieces: list[Token]) -> str:
    """The role of the last word that began a statement."""
    return next((piece.type for piece in reversed(pieces) if piece.type in STATEMENTS), "")
