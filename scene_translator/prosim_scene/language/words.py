"""The words of the language, from the table ``words.txt``: keywords, and names of metals, glasses and textures."""

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

#: Lengths are between 1 / LARGE and LARGE, so that Mitsuba's single precision holds their squares.
LARGE = 1e15
#: The largest number of pixels of an image.
PIXELS = 2**28


@dataclass(frozen=True)
class Numbers:
    """The numbers that follow a word: their count, their names in messages, and their range."""

    count: int = 1
    names: str = ""  #: such as "x y z"
    low: float = 0
    high: float = 1
    whole: bool = False
    channels: bool = False  #: r g b, or one for all channels
    direction: bool = False  #: a vector that may not have length 0
    least: float = 0  #: the smallest magnitude, except 0
    nonzero: bool = False  #: whether 0 is refused

    noun: ClassVar = "number"
    whole_type: ClassVar[type[int]] = int

    def count_in_words(self) -> str:
        """The count and the names of the numbers, for messages."""
        return f"{self.count} number{'s' * (self.count > 1)} ({self.names})" + ", or 1 for all channels" * self.channels

    def range_in_words(self) -> str:
        """The allowed values, for messages."""
        kind = "a whole number, " if self.whole else ""
        magnitude = "a magnitude of " if self.low < 0 else ""
        low = max(self.low, self.least)
        least = f"{low:g} or more, " if low > 0 or not magnitude else ""
        zero = "0, or " if self.least and not self.nonzero else ""
        return f"{zero}{kind}{magnitude}{least}{self.high:.10g} at most"

    def allows_count(self, count: int) -> bool:
        """Whether this count of numbers is allowed."""
        return count == self.count or (self.channels and count == 1)

    @staticmethod
    def parse(text: str) -> float:
        """The number that a text represents."""
        return float(text)

    def allows(self, *numbers: float) -> bool:
        """Whether all these numbers are allowed."""
        return (
            self.low <= min(numbers)
            and max(numbers) <= self.high
            and (not self.least or all(abs(n) >= self.least or (n == 0 and not self.nonzero) for n in numbers))
            and (not self.whole or all(n == int(n) for n in numbers))
        )

    def value(self, texts: Sequence[str]) -> Any:
        """The value of the texts: one number, or a tuple; None if their count is wrong, or one is not allowed."""
        numbers = tuple(map(self.parse, texts))
        if not self.allows_count(len(numbers)) or not self.allows(*numbers):
            return None
        if self.direction and math.hypot(*numbers) < 1 / LARGE:
            return None
        if self.whole:
            numbers = tuple(map(self.whole_type, numbers))
        return numbers[0] if self.count == 1 else numbers * (self.count // len(numbers))


class Flags(Numbers):
    """The TRUE or FALSE, or 1 or 0, that follow a word: their count, and their names in messages."""

    noun, whole_type = "word", bool

    def count_in_words(self) -> str:
        """The count and the names of the numbers, for messages."""
        return f"{self.count} words, each TRUE or FALSE ({self.names})" if self.count > 1 else self.range_in_words()

    def range_in_words(self) -> str:
        """The allowed values, for messages."""
        return "TRUE or FALSE"

    @staticmethod
    def parse(text: str) -> float:
        """1 for TRUE, 0 for FALSE; -1 for another text."""
        return FLAGS.get(normalise(text), -1)


NO_NUMBERS = Numbers(0)


def _numbers(cell: str) -> Numbers:
    """The numbers of a cell of the table, such as "3 r g b: 0 to 1e6, channels" or "1: TRUE or FALSE"."""
    if not cell:
        return NO_NUMBERS
    count_and_names, allowed = cell.split(": ")
    count, _, names = count_and_names.partition(" ")
    if allowed == "TRUE or FALSE":
        return Flags(int(count), names, whole=True)
    bounds, *rules = allowed.split(", ")
    low, high = map(float, bounds.split(" to "))
    rule_values: dict[str, Any] = {rule: float(*value) if value else True for rule, *value in map(str.split, rules)}
    return Numbers(int(count), names, low, high, **rule_values)


@dataclass(frozen=True)
class Word:
    """A row of the table, which describes the parts; ``statement`` is the heading above the row."""

    statement: str
    role: str
    spellings: tuple[str, ...]
    name: str
    numbers: Numbers
    kinds: tuple[str, ...]
    meaning: str

    @property
    def canonical(self) -> str:
        """The spelling that messages and the formatter use."""
        return self.spellings[0]


def _table() -> dict[str, list[list[str]]]:
    """The table ``words.txt``: heading -> the rows below it, each with its meaning, or "", and its cells."""
    table: dict[str, list[list[str]]] = {}
    for row in re.split(r"\n(?! )", Path(__file__).with_name("words.txt").read_text(encoding="utf-8")):
        if row.startswith("["):
            rows = table.setdefault(row[1:-1], [])
        elif row and row[0] != "#":
            cells, _, meaning = row.partition("\n")
            rows.append([" ".join(meaning.split()), *map(str.strip, cells.split("|"))])
    return table


def _word(
    heading: str, meaning: str, role: str, spellings: str, name: str = "", numbers: str = "", kinds: str = ""
) -> Word:
    """The word that the cells of a row describe."""
    return Word(heading, role, tuple(spellings.split()), name, _numbers(numbers), tuple(kinds.split()), meaning)


TABLE = _table()
#: The words of the statements, of their parameters, and of values.
WORDS = [
    _word(heading, *row)
    for heading, rows in TABLE.items()
    if heading.isupper() or heading in ("statements", "values")
    for row in rows
]
#: The roles of keywords that begin a statement, and the statement of the words that belong to one.
STATEMENTS = frozenset(word.role for word in WORDS if word.statement == "statements")
STATEMENT_OF = {word.role: word.statement for word in WORDS if word.statement.isupper()}
ROLES = tuple(dict.fromkeys(word.role for word in WORDS))

OPERATORS = {"+": "PLUS", "-": "MINUS", "*": "TIMES"}
MARKS = OPERATORS | {"(": "LPAR", ")": "RPAR"}
#: The order in which a message lists what it expected.
ORDER = ("NUMBER", "VARIABLE", *OPERATORS.values(), *ROLES, "TEXTURE_NAME", "FILE", "STRING", "WORD", "LPAR", "RPAR")

#: Names of metals and glasses -> Mitsuba's tables of metals, the materials of prosim_dielectric.
METALS = {name: table for _, names, table in TABLE["metals"] for name in names.split()}
GLASSES = {name: glass for _, names, glass, _ in TABLE["glasses"] for name in names.split()}
#: Indices of refraction of glasses.
INDICES = {glass: float(index) for _, _, glass, index in TABLE["glasses"]}
#: Role of a word before a name -> the field of the model, and the names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
#: The predefined textures with their kinds, and all their names.
BUILT_IN = {names.split()[0]: kind for _, names, kind in TABLE["textures"]}
ALIASES = {name: names.split()[0] for _, names, _ in TABLE["textures"] for name in names.split()}
#: The names in messages of BOOL and of tokens that are not words.
TOKEN_NAMES = {role: text for _, role, text in TABLE["tokens"]}
#: Words of other languages, and the equivalents in this language.
SUGGESTIONS = {word: text for text, words in TABLE["suggestions"] for word in words.split()}


def normalise(word: str) -> str:
    """The form in which words are compared: lower case without accents."""
    if word.isascii():
        return word.lower()
    return "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c)).lower()


#: The words of each normalised spelling, in the order of the table.
WORDS_BY_SPELLING: dict[str, list[Word]] = {}
for _word_of_table in WORDS:
    for _spelling in _word_of_table.spellings:
        WORDS_BY_SPELLING.setdefault(normalise(_spelling), []).append(_word_of_table)


@lru_cache(maxsize=1 << 10)
def find_word(role: str, spelling: str) -> Word:
    """The word of the table with this role and this spelling."""
    return next(word for word in WORDS_BY_SPELLING[normalise(spelling)] if word.role == role)


def words_of(*roles: str) -> list[Word]:
    """The words that have one of these roles."""
    return [word for word in WORDS if word.role in roles]


def spellings_of(*roles: str) -> list[str]:
    """All spellings of the words of some roles."""
    return [spelling for word in words_of(*roles) for spelling in word.spellings]


def numbers_of(role: str, name: str) -> Numbers:
    """The numbers that follow the word of this role for the model's field ``name``."""
    return next(word.numbers for word in words_of(role) if word.name == name)


def canonical_spelling(role: str) -> str:
    """The canonical spelling of the first word of a role."""
    return words_of(role)[0].canonical


def role_in_words(role: str) -> list[str]:
    """What fits where the grammar expects a role, for messages."""
    return [TOKEN_NAMES[role]] if role in TOKEN_NAMES else [word.canonical for word in words_of(role)]


def texture_name(word: str) -> str:
    """The model's name of the texture that the text calls ``word``."""
    name = normalise(word)
    return ALIASES.get(name, name)


#: The index of a SURFACE, a TRANSFORM or a primitive.
INDEX = numbers_of("SURFACE", "surfaces")
#: TRUE and FALSE, and 1 and 0, by their normalised spellings.
FLAGS = {"0": False, "1": True}
FLAGS |= {normalise(spelling): word.name == "true" for word in words_of("BOOL") for spelling in word.spellings}
#: The canonical spellings of kinds of lights, materials and textures; a material may also be absent.
KINDS = {"phong": "a surface without a material"}
KINDS |= {
    word.name: word.canonical for word in words_of("DISTRIBUTION", "CONDUCTOR", "DIELECTRIC", "MATERIAL_KIND", "KIND")
}
