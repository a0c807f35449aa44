"""Suggestions at the end of messages: the nearest known word, or the equivalent of another language's syntax."""

import difflib
import re
from collections.abc import Collection, Iterable

from .diagnostics import MAX_QUOTE, listing, quote
from .words import ALIASES, NAMED, SUGGESTIONS, TABLE, canonical, normalise, spellings

#: Each digit matches in one way only, so that the time is linear in the length.
NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?"
#: Marks of other languages: a pattern of the text, and the equivalent in this language.
MARKS = [(re.compile(pattern, re.IGNORECASE | re.MULTILINE), text) for _, pattern, *_, text in TABLE["marks"]]
BRACES = next(text for what, *_, text in TABLE["marks"] if what == "braces")
#: An operator, except for the sign of a number or of its exponent; or the `$` of a name.
ARITHMETIC = re.compile(r"[*/^$]|^[-+]$|(?<=[\d.])[-+]")

#: The textures that exist without a statement, by all their names.
TEXTURES = list(ALIASES)


def hint(word: str) -> str:
    """``; `` and the equivalent of a word of another language, or an empty string."""
    text = SUGGESTIONS.get(normalise(word))
    return f"; {text}" if text else ""


def nearest(word: str, words: Iterable[str], cutoff: float = 0.7) -> str:
    """``; did you mean 'X'?`` for the known word nearest to ``word``, or an empty string if none is near.

    A word is near if most letters agree, in order, or if its letters are a permutation.
    """
    given = normalise(word)[:MAX_QUOTE]
    known = {normalise(w): w for w in words}
    near = difflib.get_close_matches(given, known, n=1, cutoff=cutoff)
    near += [w for w in known if len(w) == len(given) > 2 and sorted(w) == sorted(given)]
    return f"; did you mean {known[near[0]]!r}?" if near else ""


def meant(word: str, roles: Collection[str]) -> str:
    """The suggestion for a word in the place of one of ``roles``: a hint, or the nearest word."""
    fitting = [*(spellings(*roles) if roles else []), *(TEXTURES if "TEXTURE_NAME" in roles else [])]
    for material, (_, names) in NAMED.items():
        if {material, "MATERIAL"} & {*roles} and normalise(word) in names:
            return f"; did you mean '{canonical(material)} {word}'?"
    return hint(word) or nearest(word, fitting) or nearest(word, spellings())


def unknown_name(role: str, word: str) -> str:
    """The reason of the error about an unknown name of a metal or of a glass after ``role``."""
    what, names = NAMED[role]
    first = {table.split("_")[0]: name for name, table in reversed(names.items())}
    allowed = [name for name in names if name in first.values()]
    near = nearest(word, [*names, *spellings("OPTIC")])
    if any(normalise(word) in others for other, others in NAMED.values() if other != what):
        near = meant(word, {"MATERIAL"})
    return f"unknown {what} {quote(word)}; expected {listing([*allowed, 'n-refr'])}{hint(word) or near}"


def of_mark(text: str, start: int) -> str:
    """``; `` and the equivalent of another language's mark at ``start``, or an empty string."""
    return next((f"; {instead}" for pattern, instead in MARKS if pattern.match(text, start)), "")
