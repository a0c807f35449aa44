"""What ``$names`` stand for while a text is read.

A name has the value that is given from without (``-D`` of the commands, ``define`` in Python), or else that of the
DEFAULT statement above its use. ``$frame`` and ``$time`` have values of themselves.
"""

import math
import re
from collections.abc import Mapping
from numbers import Real

from .hints import nearest
from .messages import Place, SceneError, Source, listing, quote

#: A name, without its ``$``.
NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?", re.IGNORECASE)
#: The names that need no value from anybody: the number of a picture in a film, and its second.
FRAME, TIME = "frame", "time"
#: Frames a second, where nothing else is said: those of the cinema.
FPS = 24.0


class UndefinedError(SceneError):
    """A name has no value; ``name``: which."""

    name = ""


class Definitions:
    """The values of names in one text, and which of them it uses.

    ``given`` are those from without; SceneError for what cannot be a name or a value. ``tolerant`` asks those who read
    the text to take a name without a value for whatever fits; ``undefined`` says whether there was one.
    """

    def __init__(self, source: Source, given: Mapping[str, object] | None = None, tolerant: bool = False) -> None:
        self.source, self.tolerant, self.undefined = source, tolerant, False
        self.given = {name: _checked(source, name, value) for name, value in (given or {}).items()}
        self.defaults: dict[str, str] = {}
        self.uses: set[str] = set()
        source.names.update({name: f"{quote(text)}, by -D {name}={text}" for name, text in self.given.items()})

    def default(self, name: str, text: str) -> None:
        """What a DEFAULT statement says of a name, from now on."""
        self.defaults[name] = text
        self.source.names.setdefault(name, quote(text))

    def text(self, name: str, place: Place) -> str:
        """The text that a name stands for; UndefinedError where it has none."""
        self.uses.add(name)
        for table in (self.given, self.defaults):
            if name in table:
                return table[name]
        if name == FRAME:
            return "0"
        if name == TIME:
            return written(self.number(FRAME, place) / FPS)
        self.undefined = True
        known = [f"${other}" for other in dict.fromkeys([*self.given, *self.defaults, FRAME, TIME])]
        error = self.source.error(
            place,
            f"nothing above says what ${name} stands for; expected DEFAULT ${name} = 1 before its use, or a value from "
            f"without: -D {name}=1, define={{{name!r}: 1}} in Python{nearest('$' + name, known)}",
        )
        undefined = UndefinedError(str(error), error.filename, error.line, error.column, error.reason, place)
        undefined.name = name
        raise undefined

    def now(self, name: str) -> str | None:
        """The text that a name stands for, if it has one."""
        try:
            return self.text(name, Place(0, 0))
        except SceneError:
            return None

    def number(self, name: str, place: Place) -> float:
        """The number that a name stands for; SceneError where it stands for something else, or for nothing."""
        text = self.text(name, place)
        if not NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            stands = self.source.names.get(name, quote(text))
            raise self.source.error(place, f"${name} stands for {stands}; expected a finite number in arithmetic")
        return float(text)

    def check_uses(self) -> None:
        """Raises SceneError for a value from without that the text, which has been read, does not use."""
        unused = [name for name in self.given if name not in self.uses | self.defaults.keys() | {FRAME, TIME}]
        if unused:
            name = unused[0]
            used = [f"${other}" for other in sorted(self.uses | self.defaults.keys())]
            there = f"it has {listing(used, 'and')}{nearest('$' + name, used)}" if used else "it has no names at all"
            raise SceneError(
                f"{self.source.filename}: {name} = {self.given[name]} is given, and nothing in the scene says ${name}; "
                + there,
                self.source.filename,
            )


def written(value: float) -> str:
    """A number as the language writes it, to the bit."""
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def _checked(source: Source, name: str, value: object) -> str:
    """The text of a value from without."""
    if not NAME.fullmatch(name):
        raise SceneError(
            f"{source.filename}: {name!r} cannot be a name; expected letters, digits and _, such as angle_2",
            source.filename,
        )
    if isinstance(value, bool):
        text = str(value).upper()
    elif isinstance(value, Real):
        text = written(float(value)) if math.isfinite(value) else ""
    else:
        text = value.strip() if isinstance(value, str) else ""
    if not text or '"' in text or not text.isprintable():
        raise SceneError(
            f"{source.filename}: {name} = {value!r} cannot stand in a scene; expected a finite number or a word",
            source.filename,
        )
    return text
