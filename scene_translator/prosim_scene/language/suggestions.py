"""Suggestions at the end of error messages: the nearest known word, or a hint about the syntax of another language."""

import difflib
import re
from collections.abc import Collection, Iterable

from .diagnostics import MAX_QUOTE, listing, quote
from .words import ALIASES, MARK_HINTS, NAMED, ROLES, SUGGESTIONS, canonical_spelling, normalise, spellings_of

#: How braces are used.
BRACES = MARK_HINTS["[{}]"]
#: A number. Each digit can match in one way only, so the time of a match is linear in the length of the text.
NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
#: Matches an arithmetic operator, or the `$` of a name; not the sign of a number or of its exponent.
ARITHMETIC = re.compile(r"[*/^$]|^[-+]$|(?<=[\d.])[-+]")


def word_hint(word: str) -> str:
    """Returns ``; `` and the equivalent of a word of another language, or "" if none is known."""
    text = SUGGESTIONS.get(normalise(word))
    return f"; {text}" if text else ""


def nearest(word: str, words: Iterable[str]) -> str:
    """Returns ``; did you mean 'X'?`` for the known word whose letters mostly agree in order, or, from three letters,
    are a permutation; else an empty string.
    """
    spelling = normalise(word)[:MAX_QUOTE]
    known = {normalise(w): w for w in words}
    near = difflib.get_close_matches(spelling, known, n=1, cutoff=0.7)
    near += [w for w in known if len(w) == len(spelling) > 2 and sorted(w) == sorted(spelling)]
    return f"; did you mean {known[near[0]]!r}?" if near else ""


def suggestion_for(word: str, roles: Collection[str]) -> str:
    """Returns a suggestion for an unknown word in a place where a word with one of the grammar ``roles`` is expected,
    or an empty string.

    If the unknown word is the name of a metal or a glass, in a place where its material may stand, the suggestion is
    this name after the keyword of its material. Otherwise, the suggestion is a hint for users of other languages, or
    the nearest known word.
    """
    fitting = [*spellings_of(*roles), *(ALIASES if "TEXTURE_NAME" in roles else [])]
    for material, (_, names) in NAMED.items():
        if {material, "MATERIAL"} & {*roles} and normalise(word) in names:
            return f"; did you mean '{canonical_spelling(material)} {word}'?"
    return word_hint(word) or nearest(word, fitting) or nearest(word, spellings_of(*ROLES))


def unknown_name(role: str, word: str) -> str:
    """Returns the text of the error that ``word`` is not the name of a known metal or glass; ``word`` follows a word
    with the grammar role ``role``, one of the keys of NAMED.

    If ``word`` is the name of a glass after the keyword of a metal, or of a metal after that of a glass, the error
    suggests the other keyword.
    """
    what, names = NAMED[role]
    # The message lists one name of each metal or glass: the first one.
    first_names = {table.split("_")[0]: name for name, table in reversed(names.items())}
    allowed = [name for name in names if name in first_names.values()]
    near = nearest(word, [*names, *spellings_of("OPTIC")])
    if any(normalise(word) in others for other, others in NAMED.values() if other != what):
        near = suggestion_for(word, {"MATERIAL"})
    return f"unknown {what} {quote(word)}; expected {listing([*allowed, 'n-refr'])}{word_hint(word) or near}"


def mark_hint(text: str, start: int) -> str:
    """Returns ``; `` and the equivalent of a mark of another language, such as ``//``, at offset ``start``, or ""."""
    for pattern, instead in MARK_HINTS.items():
        if re.compile(pattern, re.IGNORECASE | re.MULTILINE).match(text, start):
            return f"; {instead}"
    return ""
