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
    """The numbers that follow a word: how many, their names in messages, and their range."""

    count: int = 1
    what: str = ""
    low: float = 0
    high: float = 1
    whole: bool = False
    channels: bool = False  #: r g b, or one for all channels
    direction: bool = False  #: a vector that may not have length 0
    least: float = 0  #: the smallest magnitude, except 0
    nonzero: bool = False  #: whether 0 is refused

    noun: ClassVar = "number"
    whole_type: ClassVar[type[int]] = int

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} number{'s' * (self.count > 1)} ({self.what})" + ", or 1 for all channels" * self.channels

    def bounds(self) -> str:
        """The allowed values, in words."""
        kind = "a whole number, " if self.whole else ""
        magnitude = "a magnitude of " if self.low < 0 else ""
        low = max(self.low, self.least)
        least = f"{low:g} or more, " if low > 0 or not magnitude else ""
        zero = "0, or " if self.least and not self.nonzero else ""
        return f"{zero}{kind}{magnitude}{least}{self.high:.10g} at most"

    def fit(self, count: int) -> bool:
        """Whether this is an allowed count of values."""
        return count == self.count or (self.channels and count == 1)

    def number(self, text: str) -> float:
        """The number that a text stands for; NaN for another text."""
        return float(text)

    def allow(self, value: float) -> bool:
        """Whether a value is allowed."""
        return (
            self.low <= value <= self.high
            and (abs(value) >= self.least or (value == 0 and not self.nonzero))
            and (not self.whole or value == int(value))
        )

    def value(self, texts: Sequence[str]) -> Any:
        """The values: one, or a tuple; None if their count is wrong, or one is not allowed."""
        values = tuple(map(self.number, texts))
        if not self.fit(len(values)) or not all(map(self.allow, values)):
            return None
        if self.direction and math.hypot(*values) < 1 / LARGE:
            return None
        if self.whole:
            values = tuple(map(self.whole_type, values))
        return values[0] if self.count == 1 else values * (self.count // len(values))


class Flags(Numbers):
    """The TRUE or FALSE, or 1 or 0, that follow a word: how many, and their names in messages."""

    noun, whole_type = "word", bool

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} words, each TRUE or FALSE ({self.what})" if self.count > 1 else self.bounds()

    def bounds(self) -> str:
        """The allowed values, in words."""
        return "TRUE or FALSE"

    def number(self, text: str) -> float:
        """1 for TRUE, 0 for FALSE; NaN for another text."""
        return FLAGS.get(normalise(text), math.nan)


NOTHING = Numbers(0)
#: Such as "3 r g b: 0 to 1e6, channels" and "1: TRUE or FALSE".
NUMBERS = re.compile(r"(\d) ?(.*): (?:TRUE or FALSE|(\S+) to ([^\s,]+)((?:, \w+ ?[^\s,]*)*))")


def _numbers(cell: str) -> Numbers:
    """The numbers of a cell of the table. Raises ValueError for a cell of another form."""
    if not cell:
        return NOTHING
    if (found := NUMBERS.fullmatch(cell)) is None:
        raise ValueError(f"words.txt: {cell!r} are no numbers; expected COUNT NAMES: LOW to HIGH")
    count, what, low, high, rules = found.groups()
    if high is None:
        return Flags(int(count), what, whole=True)
    values: dict[str, Any] = {}
    for rule in rules.split(", ")[1:]:
        name, _, value = rule.partition(" ")
        values[name] = not value or float(value)
    return Numbers(int(count), what, float(low), float(high), **values)


@dataclass(frozen=True)
class Word:
    """A row of the table, which describes the parts; ``statement`` is the heading above the row."""

    statement: str
    role: str
    spellings: tuple[str, ...]
    name: str
    takes: Numbers
    of: tuple[str, ...]
    meaning: str

    @property
    def canonical(self) -> str:
        """The spelling that messages and the formatter use."""
        return self.spellings[0]


def _table() -> dict[str, list[list[str]]]:
    """Heading -> the rows below it: five cells, empty ones included, and the meaning."""
    table: dict[str, list[list[str]]] = {}
    for row in re.split(r"\n(?! )", Path(__file__).with_name("words.txt").read_text(encoding="utf-8")):
        if row.startswith("["):
            rows = table.setdefault(row[1:-1], [])
        elif row and row[0] != "#":
            line, *meaning = row.split("\n")
            cells = [cell.strip() for cell in re.split(r"(?<=\s)\|(?=\s|$)", line)]
            rows.append([*cells, *[""] * (5 - len(cells)), " ".join(map(str.strip, meaning))])
    return table


TABLE = _table()
WORDS = [
    Word(heading, role, tuple(spellings.split()), name, _numbers(numbers), tuple(of.split()), meaning)
    for heading, rows in TABLE.items()
    if heading.isupper() or heading in ("statements", "values")
    for role, spellings, name, numbers, of, meaning in rows
]
#: The roles of keywords that begin a statement, and the statement of the words that belong to one.
STATEMENTS = frozenset(word.role for word in WORDS if word.statement == "statements")
STATEMENT_OF = {word.role: word.statement for word in WORDS if word.statement.isupper()}
INDEX = next(word.takes for word in WORDS if word.role == "SURFACE")

OPERATORS = {"+": "PLUS", "-": "MINUS", "*": "TIMES"}
MARKS = OPERATORS | {"(": "LPAR", ")": "RPAR"}
KIND_ROLES = ("DISTRIBUTION", "CONDUCTOR", "DIELECTRIC", "MATERIAL_KIND", "KIND")
ROLES = tuple(dict.fromkeys(word.role for word in WORDS))
#: The order in which a message lists what it expected.
ORDER = ("NUMBER", "VARIABLE", *OPERATORS.values(), *ROLES, "TEXTURE_NAME", "FILE", "STRING", "WORD", "LPAR", "RPAR")

#: Names of metals and glasses -> Mitsuba's tables of metals, the materials of prosim_dielectric.
METALS = {name: table for names, table, *_ in TABLE["metals"] for name in names.split()}
GLASSES = {name: glass for names, glass, *_ in TABLE["glasses"] for name in names.split()}
#: Indices of refraction of glasses.
INDICES = {glass: float(index) for _, glass, index, *_ in TABLE["glasses"]}
#: Role of a word before a name -> the field of the model, and the names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
#: The predefined textures with their kinds, and all their names.
BUILT_IN = {names.split()[0]: kind for names, kind, *_ in TABLE["textures"]}
ALIASES = {name: names.split()[0] for names, *_ in TABLE["textures"] for name in names.split()}
#: The names in messages of BOOL and of tokens that are not words.
MEANINGS = {role: text for role, text, *_ in TABLE["tokens"]}
#: Words of other languages, and the equivalents in this language.
SUGGESTIONS = {word: text for words, *_, text in TABLE["suggestions"] for word in words.split()}


def normalise(word: str) -> str:
    """Lower case without accents: the form in which words are compared."""
    if word.isascii():
        return word.lower()
    return "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c)).lower()


#: The rows of each normalised spelling, in the order of the table.
ROWS: dict[str, list[Word]] = {}
for _row in WORDS:
    for _spelling in _row.spellings:
        ROWS.setdefault(normalise(_spelling), []).append(_row)


#: TRUE and FALSE, and 1 and 0, by their normalised spellings.
FLAGS = {normalise(s): word.name == "true" for word in WORDS if word.role == "BOOL" for s in word.spellings}
FLAGS |= {"0": False, "1": True}
#: The canonical spellings of kinds of lights, materials and textures; a material may also be absent.
KINDS = {word.name: word.canonical for word in WORDS if word.role in KIND_ROLES} | {
    "phong": "a surface without a material"
}


@lru_cache(maxsize=1 << 10)
def row(role: str, spelling: str) -> Word:
    """The row of a keyword."""
    return next(word for word in ROWS[normalise(spelling)] if word.role == role)


def of_role(*roles: str) -> list[Word]:
    """The rows of some roles."""
    return [word for word in WORDS if word.role in roles]


def spellings(*roles: str) -> list[str]:
    """All spellings of some roles; without arguments, of all roles."""
    return [spelling for word in WORDS if not roles or word.role in roles for spelling in word.spellings]


def numbers(role: str, name: str) -> Numbers:
    """The numbers that the model's ``name`` takes."""
    return next(word.takes for word in WORDS if (word.role, word.name) == (role, name))


def canonical(role: str) -> str:
    """The canonical spelling of the first word of a role."""
    return of_role(role)[0].canonical


def meanings(role: str) -> list[str]:
    """The words that fit where the grammar expects ``role``, for messages."""
    return [MEANINGS[role]] if role in MEANINGS else [word.canonical for word in of_role(role)]


def texture_name(word: str) -> str:
    """The name of a texture in the model."""
    name = normalise(word)
    return ALIASES.get(name, name)
