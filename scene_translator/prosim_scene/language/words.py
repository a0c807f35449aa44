"""Reads the words of the scene language from the file ``words.txt``: keywords, and the names of metals, glasses and
textures.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

#: Lengths in a scene are between 1 / LARGE and LARGE, so that single precision (in Mitsuba) can hold their squares.
LARGE = 1e15
#: Messages do not describe a limit below TINY or above HUGE, unless a number is beyond it.
TINY, HUGE = 1e-4, 1e6
#: The largest number of pixels of an image.
PIXELS = 2**28


@dataclass(frozen=True)
class Numbers:
    """Describes the numbers that must follow a word of the language."""

    count: int = 1
    names: str = ""  #: their names in messages, such as "x y z"
    low: float = 0
    high: float = 1
    whole: bool = False
    channels: bool = False  #: whether the numbers are r g b, or one number for all channels
    direction: bool = False  #: whether the numbers are a vector that may not have length 0
    least: float = 0  #: the smallest magnitude of a number that is not 0
    nonzero: bool = False  #: whether 0 is an error
    flags: bool = False  #: whether the numbers are flags: the words TRUE and FALSE, or 1 and 0
    also: float = 0  #: another allowed count

    def count_in_words(self) -> str:
        """Describes the count and the names of the numbers, for error messages."""
        if self.flags:
            return f"{self.count} words, each TRUE or FALSE ({self.names})" if self.count > 1 else self.range_in_words()
        also = ", or 1 for all channels" * self.channels + f", or {self.also:g}" * bool(self.also)
        return f"{self.count} number{'s' * (self.count > 1)} ({self.names}){also}"

    def range_in_words(self, number: float = 0) -> str:
        """Describes the allowed values; a limit that only computers have, such as 1e15, only if ``number`` is beyond
        it.
        """
        if self.flags:
            return "TRUE or FALSE"
        kind = "whole number" if self.whole else "number"
        low = max(self.low, self.least)
        if low > TINY or (self.low == 0 and self.high < HUGE):
            zero = "0, or " if self.least else ""
            return f"{zero}a {kind} from {low:g} to {self.high:.10g}"
        text = (
            f"a {kind}{' other than 0' * self.nonzero}" if self.low < 0 else f"{'0 or ' * (low == 0)}a positive {kind}"
        )
        magnitude = " in magnitude" * (self.low < 0)
        if 0 < (abs(number) if self.low < 0 else number) < low:
            text += f", {low:g} or more{magnitude}"
        return text + f", {self.high:.10g} at most{magnitude}" * (self.high < HUGE or abs(number) > self.high)

    def allows_count(self, count: int) -> bool:
        """Whether the word may be followed by ``count`` numbers."""
        return count == self.count or 0 < count == (1 if self.channels else self.also)

    def parse(self, text: str) -> float:
        """Converts a text to a number: a flag to 1, 0, or, if it is wrong, to -1, which is never allowed."""
        return FLAGS.get(normalise(text), -1) if self.flags else float(text)

    def allows(self, number: float) -> bool:
        """Whether ``number`` is an allowed value."""
        if not self.low <= number <= self.high or (self.whole and number != int(number)):
            return False
        return abs(number) >= self.least or (number == 0 and not self.nonzero)

    def value(self, numbers: Sequence[float]) -> Any:
        """Converts allowed numbers to a value or a tuple. A flag becomes a bool, a whole number an int; one number for
        all channels is repeated.
        """
        values = tuple(map(bool if self.flags else int, numbers)) if self.whole else tuple(numbers)
        return values[0] if self.count == 1 else values * (self.count if len(values) == 1 else 1)


NO_NUMBERS = Numbers(0)


def _numbers(cell: str) -> Numbers:
    """Parses the description of numbers in a cell of ``words.txt``, such as "3 r g b: 0 to 1e6, channels" or "1: TRUE
    or FALSE"; an empty cell means that no numbers follow the word.
    """
    if not cell:
        return NO_NUMBERS
    count_and_names, allowed = cell.split(": ")
    count, _, names = count_and_names.partition(" ")
    if allowed == "TRUE or FALSE":
        return Numbers(int(count), names, whole=True, flags=True)
    bounds, *rules = allowed.split(", ")
    low, high = map(float, bounds.split(" to "))
    rule_values: dict[str, Any] = {rule: float(*value) if value else True for rule, *value in map(str.split, rules)}
    return Numbers(int(count), names, low, high, **rule_values)


@dataclass(frozen=True)
class Word:
    """A word of the language: one row of ``words.txt``, which explains the columns.

    ``statement`` is the heading above the row in ``words.txt``, such as "LIGHTS". English ``spellings`` come first.
    ``defaults`` has the default of a pattern's parameter for each kind of pattern.
    """

    statement: str
    role: str
    spellings: tuple[str, ...]
    name: str
    numbers: Numbers
    kinds: tuple[str, ...]
    meaning: str
    defaults: Mapping[str, Any]

    @property
    def canonical(self) -> str:
        """The canonical spelling of the word, which is English."""
        return self.spellings[0]


def _table() -> dict[str, list[list[str]]]:
    """Reads ``words.txt``; returns a dictionary from each heading to the rows below this heading."""
    table: dict[str, list[list[str]]] = {}
    for row in re.split(r"\n(?! )", Path(__file__).with_name("words.txt").read_text(encoding="utf-8")):
        if row.startswith("["):
            rows = table.setdefault(row[1:-1], [])
        elif row and row[0] != "#":
            cells, _, meaning = row.partition("\n")
            rows.append([" ".join(meaning.split()), *map(str.strip, cells.split("|"))])
    return table


def _word(heading: str, meaning: str, role: str, spellings: str, *cells: str) -> Word:
    name, numbers, kinds, defaults = [*cells, "", "", "", ""][:4]
    allowed, of, texts = _numbers(numbers), tuple(kinds.split()), defaults.split(", ") if defaults else []
    values = {kind: allowed.value([*map(allowed.parse, text.split())]) for kind, text in zip(of, texts)}
    if texts:
        meaning += " Default: " + " or ".join(texts) + "."
    return Word(heading, role, tuple(_all_spellings(spellings)), name, allowed, of, meaning, values)


#: The English and the Portuguese spellings of each word and name that has both, the main spelling first.
TRANSLATIONS: list[tuple[list[str], list[str]]] = []


def _all_spellings(cell: str) -> list[str]:
    english, portuguese = (part.split() for part in f"{cell}/".split("/")[:2])
    if portuguese:
        TRANSLATIONS.append((english, portuguese))
    return english + portuguese


TABLE = _table()
#: The words of statements, the words of their parameters, and the words that are values.
WORDS = [
    _word(heading, *row)
    for heading, rows in TABLE.items()
    if heading.isupper() or heading in ("statements", "values")
    for row in rows
]
#: The roles of the keywords that begin a statement.
STATEMENTS = frozenset(word.role for word in WORDS if word.statement == "statements")
#: Role of a word -> the statement to which the word belongs.
STATEMENT_OF = {word.role: word.statement for word in WORDS if word.statement.isupper()}
ROLES = tuple(dict.fromkeys(word.role for word in WORDS))

OPERATORS = {"+": "PLUS", "-": "MINUS", "*": "TIMES"}
MARKS = OPERATORS | {"(": "LPAR", ")": "RPAR"}
#: The order in which an error message lists the expected roles.
ORDER = ("NUMBER", "VARIABLE", *OPERATORS.values(), *ROLES, "TEXTURE_NAME", "FILE", "STRING", "WORD", "LPAR", "RPAR")

#: The roles of the words that may follow a keyword with the role CHOICE: for each keyword its name in capitals.
CHOICES = frozenset(word.name.upper() for word in WORDS if word.role == "CHOICE")

#: Name of a metal -> the name of its table of optical constants in Mitsuba.
METALS = {name: table for _, names, table in TABLE["metals"] for name in _all_spellings(names)}
#: Name of a glass -> the value of the parameter ``material`` of the plugin prosim_dielectric.
GLASSES = {name: glass for _, names, glass, _ in TABLE["glasses"] for name in _all_spellings(names)}
#: Value of the parameter ``material`` of the plugin prosim_dielectric -> the glass's index of refraction at 587.6 nm.
INDICES = {glass: float(index) for _, _, glass, index in TABLE["glasses"]}
#: Role of a word that a name follows -> the field of the model that the name sets, and the known names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
#: Name of a predefined texture -> its kind.
BUILT_IN = {names.split()[0]: kind for _, names, kind in TABLE["textures"]}
#: Each name of a predefined texture -> the first of its names.
ALIASES = {name: names.split()[0] for _, names, _ in TABLE["textures"] for name in _all_spellings(names)}
#: Role of a token that is not a word, or BOOL -> the name of the role in messages.
TOKEN_NAMES = {role: text for _, role, text in TABLE["tokens"]}
#: Role of an operator -> the meaning of this operator, as Markdown.
TOKEN_MEANINGS = {role: meaning for meaning, role, _ in TABLE["tokens"] if meaning}
#: Word of another scene language -> a hint, the equivalent in this language.
SUGGESTIONS = {word: text for text, words in TABLE["suggestions"] for word in words.split()}
#: Pattern of a mark of another language, at its beginning in the text -> a hint, the equivalent in this language.
MARK_HINTS = dict(TABLE["marks"])


def normalise(word: str) -> str:
    """Returns a word in lower case and without accents, for comparisons with other words."""
    if word.isascii():
        return word.lower()
    return "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c)).lower()


#: Normalised spelling -> the words that have this spelling, in the order of ``words.txt``.
WORDS_BY_SPELLING: dict[str, list[Word]] = {}
for _word_of_table in WORDS:
    for _spelling in _word_of_table.spellings:
        WORDS_BY_SPELLING.setdefault(normalise(_spelling), []).append(_word_of_table)


@lru_cache(maxsize=1 << 10)
def find_word(role: str, spelling: str) -> Word:
    """Returns the word of ``words.txt`` that has the grammar role ``role`` and the spelling ``spelling``."""
    return next(word for word in WORDS_BY_SPELLING[normalise(spelling)] if word.role == role)


def preferred_spellings(text: str) -> dict[str, str]:
    """Returns a dictionary from the main English spelling of each word or name to the spelling that a message about
    ``text`` uses: the most frequent one in ``text``, or else the main one in the language of most words of ``text``.
    """
    counts = Counter[str]()
    for word, count in Counter(re.findall(r"[^\W\d_][\w-]*", re.sub(r"#[^\n]*|\([^()]*\)", " ", text))).items():
        counts[normalise(word)] += count
    languages = [{normalise(s) for words in column for s in words} for column in zip(*TRANSLATIONS)]
    english, portuguese = (sum(counts[s] for s in own - other) for own, other in (languages, languages[::-1]))
    preferred = {}
    for words, translations in TRANSLATIONS:
        spellings = translations + words if portuguese > english else words + translations
        preferred[words[0]] = max(spellings, key=lambda spelling: counts[normalise(spelling)])
    return preferred


def words_of(*roles: str) -> list[Word]:
    """Lists the words whose grammar role is one of ``roles``."""
    return [word for word in WORDS if word.role in roles]


def spellings_of(*roles: str) -> list[str]:
    """Lists all spellings of the words whose grammar role is one of ``roles``."""
    return [spelling for word in words_of(*roles) for spelling in word.spellings]


def numbers_of(role: str, name: str) -> Numbers:
    """Describes the numbers after the word that has this role and sets the field ``name`` of the model."""
    return next(word.numbers for word in words_of(role) if word.name == name)


def canonical_spelling(role: str) -> str:
    """Returns the canonical spelling of the first word in ``words.txt`` that has the grammar role ``role``."""
    return words_of(role)[0].canonical


def role_in_words(role: str) -> list[str]:
    """Lists the words or tokens of the language that have a grammar role, for error messages."""
    return [TOKEN_NAMES[role]] if role in TOKEN_NAMES else [word.canonical for word in words_of(role)]


def texture_name(word: str) -> str:
    """Returns the model's name of a texture: the main name of a predefined one, or else the normalised word."""
    name = normalise(word)
    return ALIASES.get(name, name)


#: Spellings that are also words of English prose, so that messages do not translate them.
PROSE = {word.canonical for word in words_of("LIGHT_PARAMETER", "PARAMETER", "KIND") if word.canonical.isalpha()}
#: Describes the index of a SURFACE, a TRANSFORM or a primitive.
INDEX = numbers_of("SURFACE", "surfaces")
#: Normalised spelling of TRUE, FALSE, 1 or 0 -> its value.
FLAGS = {"0": False, "1": True}
FLAGS |= {normalise(spelling): word.name == "true" for word in words_of("BOOL") for spelling in word.spellings}
#: Kind of a light, a material or a texture -> its name in messages; "phong" is a surface without a material.
KINDS = {"phong": "a surface without a material"}
_NAMED = words_of("DISTRIBUTION", "CONDUCTOR", "DIELECTRIC", "MATERIAL_KIND", "KIND")
KINDS |= {word.name: word.canonical for word in _NAMED}
