"""Text -> the values of its statements, and where they stand: a recursive descent over the roles of ``words``.

Wrong values are reported, and the reader goes on. What does not parse ends its statement; the reader goes on at the
next line that begins with the keyword of a statement.
"""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from .. import model
from . import checks, words
from .diagnostics import CLIP, MOST, Diagnostic, SceneError, Source, Span, diagnostic, listing, quote
from .document import Path
from .suggestions import NUMBER, TEXTURES, hint, hint_within, meant, nearest, of_mark, spaced, unknown_name
from .tokens import Definitions, Scanner, Token, UndefinedError
from .words import STATEMENTS, Numbers, normalise, row

#: The most nodes of a tree that is made of named solids.
LARGEST = 10**5
#: A line that begins with the keyword of a statement.
STATEMENT_LINE = re.compile(
    rf"^[ \t]*(?:{'|'.join(sorted(map(re.escape, words.spellings(*STATEMENTS)), key=len, reverse=True))})(?![\w.-])",
    re.IGNORECASE | re.MULTILINE,
)
#: What a statement is followed by: another one, or the end of the text.
NEXT = STATEMENTS | {""}
#: What has a place within each statement.
NAMES = frozenset(("WORD", "STRING", "FILE", "TEXTURE_NAME", "NUMBER"))
VALUE = frozenset(("NUMBER", "WORD", "STRING"))
FLAGS = NEXT | {"BOOL"}
FILE = frozenset(("FILE", "STRING"))
IMAGE = NEXT | {"FILE", "STRING", "NULL"}
LIGHTS = NEXT | {"LIGHT"}
LIGHT = LIGHTS | {"LIGHT_PARAMETER", "DISTRIBUTION"}
VIEW = NEXT | {"VIEW_PARAMETER", "VRP"}
TREE = NEXT | {"PLUS", "MINUS", "TIMES", "PRIMITIVE", "USE"}  # the name of a solid
SLOTS = TREE | {"TEXTURE_NAME", "FILE", "STRING", "NULL"}
SURFACE = NEXT | {"MATERIAL", "METAL", "OPTIC"}
MATERIAL = frozenset(("MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC"))
TRANSFORM = NEXT | {"STEP"}
STEP = TRANSFORM | {"NUMBER", "LPAR"}
ARGUMENT = frozenset(("RPAR",))
TEXTURE = NEXT | {"PARAMETER"}

#: Numbers as other languages write them. A comma is not read: in 0,5 it may be a point, or stand between two numbers.
SEPARATED = re.compile(r"[-+.e\d]*[,;][-+.e\d,;]*", re.IGNORECASE)
#: Sizes as they are written elsewhere: 320x240; and shares: 60%.
BY_SIGN = re.compile("[x×]", re.IGNORECASE)
BY = re.compile(r"[-+.\d]+([x×][-+.\d]+)+", re.IGNORECASE)
PERCENT = re.compile(rf"({NUMBER})%")
#: An operator, but for the sign of a number or of its exponent.
ARITHMETIC = re.compile(r"[*/^$]|^[-+]$|(?<=[\d.])[-+]")
BRACES = "; arithmetic stands in braces, as in {360 * $frame / 48}"
A_LIGHT = "; a light begins with AREA or POINT, as in POINT position 0 20 10 SPOT"
#: What may have been meant as the value of the keyword before it.
PARENTHESES = re.compile(r"[\s:=]*\([-+.\d\s,;e]*\)", re.IGNORECASE)
HTML_COLOR = re.compile(r"[\s:=]*#([0-9a-f]{6})\b", re.IGNORECASE)
#: Trees as other languages write them.
SOLID = rf"(?:{'|'.join(words.spellings('PRIMITIVE'))})\s+\d+"
PREFIX = re.compile(SOLID, re.IGNORECASE)
INFIX = re.compile(rf"{SOLID}[^()+*-]*\)*\s*[+*-]\s*\(*\s*{SOLID}", re.IGNORECASE)
EXPLAINED = "operators come before their operands, as in - CUBE 1 SPHERE 2, and parentheses are remarks"


@cache
def _and_numbers(roles: frozenset[str]) -> frozenset[str]:
    return roles | {"NUMBER"}


class Skipped(NamedTuple):
    """A statement of which something could not be read.

    ``role`` and ``start``: of its keyword; ``end``: where the reader went on; ``path``: of its value, () if unknown.
    """

    role: str
    start: int
    end: int
    path: Path
    error: Diagnostic


class Reader:
    """A text, read.

    ``fields``: what it says, by the fields of a Scene, ``defaults`` and ``solids``; ``spans``: where, by the paths of
    the values; ``diagnostics``: what is wrong within its statements; ``tokens``: all tokens up to END; ``skipped``: the
    statements that could not be read. Where there are more than MOST errors, the text is ``cut``: what follows has not
    been read.

    ``tolerant``: names without values are read as whatever fits; ``define``: values of names from outside.
    """

    def __init__(
        self, text: str, filename: str = "<string>", define: Mapping[str, object] | None = None, tolerant: bool = False
    ) -> None:
        self.source = Source(text, filename)
        self.definitions = Definitions(self.source, define)
        self.scanner = Scanner(self.source, self.definitions, tolerant)
        self.fields: dict[str, Any] = {"defaults": {}, "solids": {}, "surfaces": {}, "transforms": {}, "patterns": {}}
        self.spans: dict[Path, Span] = {}
        self.diagnostics: list[Diagnostic] = []
        self.skipped: list[Skipped] = []
        self.wrong = 0  # how many errors there are
        self.cut = False
        #: The last token, and the roles of which it had to be one.
        self.token = Token("", "", 0, 0)
        self.expected: frozenset[str] = NEXT
        #: Of the statement that is being read: its keyword, the path of its value, and the spans in it.
        self.keyword = self.token
        self.path: Path = ()
        self.own: dict[Path, Span] = {}
        self.open = Span(0, 0)  # the parenthesis of a step
        self.statements()
        if self.token.role == "END":
            self.scanner.rest()
        self.diagnostics += self.scanner.warnings

    @property
    def tokens(self) -> list[Token]:
        """All tokens up to END, comments included, and what follows END as one REST."""
        return self.scanner.tokens

    # ---- The text, statement by statement

    def statements(self) -> None:
        """Reads all statements."""
        begun = False
        while True:
            told = len(self.diagnostics)
            try:
                if not begun:
                    self.keyword, self.path = Token("", "", self.scanner.position, self.scanner.position), ()
                    self.next(NEXT)
                begun = True
                self.keyword, self.path, self.own = self.token, (), {}
                if self.keyword.role in ("END", ""):
                    return
                self.give(getattr(self, self.keyword.role.lower())())
            except SceneError as error:
                begun = False
                del self.diagnostics[told:]  # what does not parse has one error
                self.skip(error)
                if self.scanner.position == len(self.source.text):
                    return
            if self.wrong > MOST:
                self.cut = True
                return

    def give(self, value: Any) -> None:
        """Takes the value of a statement, unless the text has given it before."""
        path = self.path
        if not path:
            self.lose(self.token.start, self.diagnostics[-1])
            return
        if path in self.spans:
            kind = self.keyword.role
            given = [self.keyword.text if kind == "SETTING" else words.canonical(kind)]
            given += [f"{'$' * (kind == 'DEFAULT')}{index}" for index in path[1:]]
            self.report(
                self.own[path],
                f"{' '.join(given)} is given twice; the first is on line {self.source.line(self.spans[path])}",
                "twice",
            )
            return
        self.spans.update(self.own)
        field, *index = path
        if index:
            self.fields[str(field)][index[0]] = value
        else:
            self.fields[str(field)] = value

    def skip(self, error: SceneError) -> None:
        """Reports an error, and goes on at the next line that begins with the keyword of a statement."""
        one = diagnostic(error, error.name if isinstance(error, UndefinedError) else None)
        self.diagnostics.append(one)
        self.wrong += 1
        after = STATEMENT_LINE.search(self.source.text, max(one.start, self.keyword.start) + 1)
        self.scanner.position = after.start() if after else len(self.source.text)
        while self.tokens and self.tokens[-1].end > self.scanner.position:
            self.tokens.pop()
        self.lose(self.scanner.position, one)

    def lose(self, end: int, error: Diagnostic) -> None:
        """Notes a statement that could not be read."""
        path = self.path
        if self.keyword.role in ("SURFACE", "TRANSFORM") and not path:
            own = (token for token in self.tokens[-40:] if token.start > self.keyword.start)
            index = next((token.text for token in own if token.role == "NUMBER"), "")
            if index.isdecimal() and len(index) < 10:
                path = row(self.keyword.role, self.keyword.text).name, int(index)
        self.skipped.append(Skipped(self.keyword.role, self.keyword.start, end, path, error))

    # ---- Tokens

    def next(self, expected: frozenset[str]) -> str:
        """Moves on to the next token; returns its role, which is one of the expected ones, or raises SceneError."""
        self.expected = expected
        self.token = token = self.scanner.next(expected, self.keyword.role)
        if token.role not in expected:
            if "USE" not in expected or normalise(token.text) not in self.fields["solids"]:
                raise self.unexpected(token)
            self.token = self.tokens[-1] = self.scanner.last = token._replace(role="USE")
        return self.token.role

    def numbers(self, follow: frozenset[str]) -> list[Token]:
        """The numbers from the next token on; the first other token is of a role that follows."""
        expected, tokens = _and_numbers(follow), self.scanner.plain_numbers()
        while self.next(expected) in ("NUMBER", "BOOL"):
            tokens.append(self.token)
        return tokens

    def report(self, where: Token | Span, reason: str, code: str) -> None:
        """Adds an error."""
        span = where.span if isinstance(where, Token) else where
        self.diagnostics.append(self.source.diagnostic(span, reason, code, error=True))
        self.wrong += 1

    def begin(self, *path: str | int, at: Token | None = None) -> None:
        """The path of the statement's value, whose place is the keyword or ``at``."""
        self.path = path
        self.own[path] = (at or self.keyword).span

    def once(self, token: Token, what: str, *path: str | int) -> None:
        """Notes where a value is given; reports it where it was given before."""
        if path in self.own:
            line = self.source.line(self.own[path])
            self.report(token, f"{what} is given twice; the first is on line {line}", "twice")
        else:
            self.own[path] = token.span

    def note(self, span: Span, *path: str | int) -> None:
        """Notes where a part of the statement's value stands."""
        whole = (*self.path, *path)
        self.own[whole] = span

    # ---- Values

    def value(self, keyword: Token, tokens: Sequence[Token]) -> Any:
        """The value of the tokens after a keyword, by its row: a number or a tuple; None if it is wrong."""
        takes = words.INDEX if keyword.role == "USE" else row(keyword.role, keyword.text).takes
        if isinstance(takes, words.Flags):
            return self.flags(keyword, tokens, takes)
        assert takes is not None
        value = None
        with suppress(ValueError):  # TRUE is no number
            value = takes.value([float(token.text) for token in tokens])
        if value is None:
            self.wrong_numbers(keyword, tokens, takes)
        return value

    def wrong_numbers(self, keyword: Token, tokens: Sequence[Token], takes: Numbers) -> None:
        """Reports what is wrong with the numbers after a keyword."""
        for token in tokens:
            if token.role == "BOOL":
                return self.report(token, f"found {quote(token.text)} after {keyword.text}; expected a number", "count")
        if len(tokens) not in ((1, 3) if takes.channels else (takes.count,)):
            return self.miscounted(keyword, tokens, takes)
        for token in tokens:
            if not takes.allow(float(token.text)):
                reason = _out_of_range(keyword, token, takes)
                return self.report(token, f"found {quote(token.text)}{reason}", "range")
        return self.report(tokens[0], f"{keyword.text} has length 0; expected a direction", "range")

    def miscounted(self, keyword: Token, tokens: Sequence[Token], takes: Numbers) -> None:
        """Reports a wrong count of numbers."""
        expected = takes.counted()
        end = tokens[-1].end if tokens else keyword.end
        if comment := PARENTHESES.match(self.source.text[end : end + 2 * CLIP]):
            written = comment[0].strip(" :=")
            expected += f"; {quote(written)} is a remark, as parentheses are"
            expected += f"; without them: {numbers}" if (numbers := spaced(written[1:-1])) else ""
        if html := HTML_COLOR.match(self.source.text, end):
            values = " ".join(f"{int(html[1][i : i + 2], 16) / 255:.3g}" for i in (0, 2, 4))
            expected += f"; {html[0].strip(' :=')!r} is a remark, and this colour is {values}"
        count = f"{len(tokens)} number{'s' * (len(tokens) != 1)}"
        self.report(_span(tokens or [keyword]), f"found {count} after {keyword.text}; expected {expected}", "count")

    def flags(self, keyword: Token, tokens: Sequence[Token], takes: words.Flags) -> bool | tuple[bool, ...] | None:
        """The value of TRUE and FALSE, or 1 and 0."""
        wrong = next((token for token in tokens if token.role == "NUMBER" and token.text not in ("0", "1")), None)
        if wrong is not None:
            self.report(wrong, f"found {quote(wrong.text)} after {keyword.text}; expected TRUE or FALSE", "count")
            return None
        if len(tokens) != takes.count:
            count = f"{len(tokens)} word{'s' * (len(tokens) != 1)}"
            reason = f"found {count} after {keyword.text}; expected {takes.counted()}"
            self.report(_span([keyword, *tokens]), reason, "count")
            return None
        result = tuple(t.text == "1" if t.role == "NUMBER" else row(t.role, t.text).name == "true" for t in tokens)
        return result if takes.count > 1 else result[0]

    def parameter(self, values: dict[str, Any], follow: frozenset[str], *owner: str | int) -> list[Token]:
        """Puts the value of the keyword at hand into ``values``; returns the keyword and its numbers."""
        keyword = self.token
        name = row(keyword.role, keyword.text).name
        self.once(keyword, keyword.text, *owner, name)
        tokens = self.numbers(follow)
        value = self.value(keyword, tokens)
        if value is not None:
            values[name] = value
        return [keyword, *tokens]

    def index(self, table: str, follow: frozenset[str]) -> int | None:
        """The index after SURFACE or TRANSFORM."""
        tokens = self.numbers(follow)
        index: int | None = self.value(self.keyword, tokens)
        if index is not None:
            self.begin(table, index)
        return index

    # ---- Statements, by the roles of their keywords. Each returns its value, and leaves the next keyword as ``token``.

    def default(self) -> str:
        """DEFAULT."""
        self.next(frozenset(("VARIABLE",)))
        name = self.token
        self.next(VALUE)
        value = self.token.text
        self.begin("defaults", name.text[1:], at=name)
        self.next(NEXT)
        self.definitions.default(name.text[1:], value)
        return value

    def setting(self) -> Any:
        """A statement of one keyword and its values."""
        keyword = self.keyword
        name = row(keyword.role, keyword.text).name
        self.begin(name)
        value = self.value(keyword, self.numbers(FLAGS))
        if name == "channels" and value and not any(value):
            reason = f"{keyword.text} leaves out all channels; expected TRUE for one at least"
            self.report(keyword, reason, "range")
        return value

    def name(self) -> str:
        """NAME."""
        self.begin("name")
        self.next(NAMES)
        token = self.token
        name = token.text
        self.next(NEXT)
        if not name.strip() or name in (".", "..") or any(c in '/\\:*?<>|"' or not c.isprintable() for c in name):
            self.report(token, f"found {quote(name)}; expected the base name of a file, without a folder", "name")
        elif len(name) > 200:
            self.report(token, f"found a name of {len(name)} characters; expected 200 at most", "name")
        return name

    def background(self) -> model.Background | None:
        """BACKGROUND."""
        self.begin("background")
        tokens, image = self.numbers(IMAGE), None
        if self.token.role in ("FILE", "STRING"):
            self.own["background", "image"], image = self.token.span, self.token.text
            if not tokens:
                self.report(
                    self.token,
                    f"found {quote(image)} after BACKGROUND; expected 3 numbers (r g b) before the image",
                    "count",
                )
        if self.token.role not in NEXT:
            self.next(NEXT)
        color = self.value(self.keyword, tokens) if tokens or image is None else None
        return None if color is None else model.Background(color, image)

    def lights(self) -> tuple[model.Light, ...]:
        """LIGHTS."""
        self.begin("lights")
        lights: list[model.Light] = []
        role = self.next(LIGHTS)
        while role == "LIGHT":
            lights.append(self.light(len(lights)))
            role = self.token.role
        return tuple(lights)

    def light(self, number: int) -> model.Light:
        """One light."""
        keyword, owner = self.token, ("lights", number)
        self.own[owner] = keyword.span
        values: dict[str, Any] = {}
        sky = row("LIGHT", keyword.text).name == "sky"
        if sky:
            self.next(FILE)
            self.once(self.token, "the image", *owner, "image")
            values["image"] = self.token.text
        role = self.next(LIGHTS if sky else LIGHT)
        while role in ("LIGHT_PARAMETER", "DISTRIBUTION"):
            if role == "DISTRIBUTION":
                self.once(self.token, "the distribution of a light", *owner, "distribution")
                values["distribution"] = row(role, self.token.text).name
                role = self.next(LIGHT)
            else:
                self.parameter(values, LIGHT, *owner)
                role = self.token.role
        if (*owner, "position") not in self.own and not sky:
            reason = f"this {keyword.text} light has no position; expected where it is after {keyword.text}, such as "
            self.report(keyword, reason + "position 0 20 10", "incomplete")
        if values.get("distribution") == "cone":
            values.setdefault("angle", 30.0)
        light = model.Light(row(keyword.role, keyword.text).name, **values)
        self.effects(checks.light_effects(light.distribution), owner)
        return light

    def view(self) -> model.View:
        """VIEW."""
        self.begin("view")
        values: dict[str, Any] = {}
        role = self.next(VIEW)
        while role in ("VIEW_PARAMETER", "VRP"):
            tokens = self.parameter(values, VIEW | {"MINUS"} if role == "VRP" else VIEW, "view")
            self.own["view", row(role, tokens[0].text).name] = _span(tokens)
            role = self.token.role
            if role == "MINUS":  # the stray dash of the thesis's listing
                role = self.next(VIEW)
        if math.prod(values.get("resolution", ())) > words.PIXELS:
            reason = f"these are too many pixels; expected {words.PIXELS} at most"
            self.report(self.own["view", "resolution"], reason, "range")
        return model.View(**values)

    def surface(self) -> model.Surface:
        """SURFACE."""
        wrong = self.wrong
        index = self.index("surfaces", SURFACE)
        owner: Path = ("surfaces", -1 if index is None else index)
        values: dict[str, Any] = {}
        while (role := self.token.role) not in NEXT:
            if role != "OPTIC":
                self.material(values, *owner)
                continue
            keyword = self.parameter(values, SURFACE, *owner)[0]
            if row(role, keyword.text).name in ("exponent", "slope"):
                self.once(keyword, "the roughness", *owner, "roughness")
        surface = model.Surface(**values)
        if self.wrong == wrong:
            if lack := checks.wrong(surface):
                self.report(self.own.get((*owner, *lack[1:]), self.keyword.span), lack[0], "optics")
            else:
                self.effects(checks.surface_effects(surface.material, surface.transmittance is not None), owner)
        return surface

    def material(self, values: dict[str, Any], *owner: str | int) -> None:
        """``material`` and its kind, with the name of a metal or glass after some, or ``metal`` and its name."""
        keyword = kind = self.token
        if keyword.role == "MATERIAL":
            self.once(keyword, "the material", *owner, "material")
            self.next(MATERIAL)
            kind = self.token
            values["material"] = row(kind.role, kind.text).name
            if self.next(SURFACE if kind.role == "MATERIAL_KIND" else SURFACE | {"WORD"}) != "WORD":
                return
        else:
            self.next(frozenset(("WORD",)))
            values.setdefault("material", "conductor")
        name = self.token
        if unknown := unknown_name(kind.role, name.text):
            raise self.source.error(name.span, unknown, "unknown-name")
        which, table = ("glass", words.GLASSES) if kind.role == "DIELECTRIC" else ("metal", words.METALS)
        self.once(keyword if keyword.role == "METAL" else name, f"the {which}", *owner, which)
        values[which] = table.get(normalise(name.text))
        self.next(SURFACE)

    def transform(self) -> model.Transform:
        """TRANSFORM."""
        self.index("transforms", TRANSFORM)
        steps = []
        while self.token.role == "STEP":
            keyword = self.token
            tokens: list[Token] = []
            role = self.next(STEP)
            if role == "LPAR":
                self.open = self.token.span
                tokens = self.numbers(ARGUMENT)
                self.next(TRANSFORM)
            elif role == "NUMBER":
                tokens = [self.token, *self.numbers(TRANSFORM)]
            value = self.value(keyword, tokens)
            name = row(keyword.role, keyword.text).name
            steps.append(model.Step(name, value if isinstance(value, tuple) else (value,)))
        return model.Transform(tuple(steps))

    def texture(self) -> model.Pattern | None:
        """TEXTURE."""
        self.next(frozenset(("TEXTURE_NAME",)))
        token = self.token
        name = words.texture_name(token.text)
        self.begin("patterns", name)
        kind, values = words.BUILT_IN.get(name), dict[str, Any]()
        if self.next(TEXTURE | {"KIND"}) == "KIND":
            word = self.token
            brick = row("KIND", word.text).name == "brick"  # a kind, and with numbers a parameter
            tokens = self.numbers(TEXTURE) if brick else []
            if not brick:
                self.next(TEXTURE)
            if tokens:
                word = word._replace(role="PARAMETER")
                self.once(word, word.text, "patterns", name, "brick")
                values["brick"] = self.value(word, tokens)
            else:
                kind = row("KIND", word.text).name
        if kind is None:
            reason = f"the texture {quote(token.text)} has no kind; expected brick, stripes or fractal after its name"
            self.report(token, reason + nearest(name, list(words.BUILT_IN)), "incomplete")
        while self.token.role == "PARAMETER":
            keyword = self.token
            if kind is not None and kind not in row("PARAMETER", keyword.text).of:
                known = listing(word.canonical for word in words.of_role("PARAMETER") if kind in word.of)
                reason = f"found {quote(keyword.text)} in a texture of kind {kind}; expected {known}"
                self.report(keyword, reason, "unexpected")
            self.parameter(values, TEXTURE, "patterns", name)
        return model.Pattern(kind, tuple(sorted(values.items()))) if kind else None

    def csg_tree(self) -> tuple[model.Operator | model.Leaf, ...]:
        """CSG-TREE."""
        self.begin("csg")
        return self.tree()

    def solid(self) -> tuple[model.Operator | model.Leaf, ...]:
        """SOLID: a tree with a name."""
        self.next(frozenset(("WORD",)))
        token = self.token
        name = normalise(token.text)
        self.begin("solids", name, at=token)
        if name in words.ROWS:
            self.report(token, f"found {quote(token.text)}, a word of the language; expected a name of its own", "name")
        wrong, nodes = self.wrong, self.tree()
        if not nodes and self.wrong == wrong:
            self.report(token, f"this solid is empty; expected its tree after {token.text}", "incomplete")
        return nodes

    def tree(self) -> tuple[model.Operator | model.Leaf, ...]:
        """Operators and primitives in prefix order; the nodes of a named solid stand in the place of its name."""
        wrong, first = self.wrong, len(self.tokens)
        nodes: list[model.Operator | model.Leaf] = []
        missing, extra = 1, 0
        role = self.next(TREE)
        while role not in NEXT:
            if not missing and not extra:
                extra = len(nodes)
            if role in ("PRIMITIVE", "USE"):
                missing -= 1
                nodes += [self.leaf(len(nodes))] if role == "PRIMITIVE" else self.use(len(nodes))
                role = self.token.role
            else:
                missing += 1
                self.note(self.token.span, len(nodes))
                nodes.append(OPERATOR[self.token.text])
                role = self.next(TREE)
        self.comments_in_tree(self.tokens[first:], not nodes)
        if (extra or (missing and nodes)) and self.wrong == wrong:
            self.wrong_tree(nodes, extra)
        return tuple(nodes) if self.wrong == wrong else ()

    def use(self, number: int) -> list[model.Operator | model.Leaf]:
        """The nodes of a solid whose name stands in a tree, with its index."""
        keyword, solid = self.token, self.fields["solids"][normalise(self.token.text)]
        tokens = self.numbers(TREE)
        index = self.value(keyword, tokens)
        if number + len(solid) > LARGEST:
            raise self.source.error(keyword.span, f"this makes more than {LARGEST} nodes; expected fewer", "range")
        span = _span([keyword, *tokens])
        for i in range(len(solid)):
            self.note(span, number + i)
        within = () if index is None else (index,)
        return [replace(n, within=n.within + within) if isinstance(n, model.Leaf) else n for n in solid]

    def leaf(self, number: int) -> model.Leaf:
        """A primitive, its index, a mesh's file, and its texture slots."""
        keyword, slots = self.token, list[model.Texture | None]()
        shape, file = row("PRIMITIVE", keyword.text).name, None
        tokens = self.numbers(FILE if shape == "mesh" else SLOTS)
        index = self.value(keyword, tokens)
        end = (tokens or [keyword])[-1].end
        if shape == "mesh":
            self.note(self.token.span, number, "file")
            file, end = self.token.text, self.token.end
            self.next(SLOTS)
        while self.token.role not in TREE:
            if len(slots) < 2:
                self.note(self.token.span, number, "textures", len(slots))
            elif len(slots) == 2:
                reason = f"found {quote(self.token.text)}, a third texture; expected two at most"
                self.report(self.token, reason, "count")
            slots.append(_texture(self.token))
            end = self.token.end
            self.next(SLOTS)
        self.note(Span(keyword.start, end), number)
        textures = (slots[0], slots[1] if len(slots) > 1 else None) if slots else (None, None)
        return model.Leaf(shape, -1 if index is None else index, textures, file=file)

    def wrong_tree(self, nodes: Sequence[model.Operator | model.Leaf], extra: int) -> None:
        """Reports the first node that is too many, or the operator that lacks an operand."""
        spans = [self.own[path] for path in [(*self.path, number) for number in range(len(nodes))]]
        if infix := _infix(self.source, nodes, spans):
            found = f"found {quote(self.source.text[slice(*spans[1])])} between its operands; expected it before them: "
            self.report(spans[1], found + (infix if len(infix) <= CLIP else EXPLAINED), "infix")
        elif extra:
            span = spans[extra]
            word = self.source.text[span.start : span.end].split()[0]
            self.report(
                Span(span.start, span.start + len(word)),
                f"found {quote(word)} after the tree is complete; expected the next statement, or "
                f"one more operator before the operands: {EXPLAINED}",
                "tree",
            )
        else:
            missing: list[list[int]] = []  # the operators that lack operands: their numbers, and how many
            for number, node in enumerate(nodes):
                if isinstance(node, model.Operator):
                    missing.append([number, 2])
                    continue
                while missing:
                    missing[-1][1] -= 1
                    if missing[-1][1]:
                        break
                    missing.pop()
            number, count = missing[-1]
            self.report(
                spans[number],
                f"this {quote(self.source.text[slice(*spans[number])])} lacks "
                f"{'an operand' if count == 1 else 'two operands'}; expected a primitive or an operator: {EXPLAINED}",
                "tree",
            )

    def comments_in_tree(self, tokens: Sequence[Token], empty: bool) -> None:
        """Reports comments in parentheses that hold what looks like the tree, or a part of it."""
        for token in tokens:
            if token.role == "COMMENT" and token.text[0] == "(" and PREFIX.search(token.text):
                if empty:
                    raise self.source.error(token.span, f"the tree stands in a remark: {EXPLAINED}", "tree-in-comment")
                if INFIX.search(token.text):
                    reason = f"this remark reads like a part of the tree: {EXPLAINED}"
                    self.diagnostics.append(self.source.diagnostic(token.span, reason, "tree-in-comment"))

    def effects(self, without: Sequence[tuple[str, str]], owner: Path) -> None:
        """Warns of given values that have no effect: their names, and the reasons after the word itself."""
        for name, reason in without:
            if span := self.own.get((*owner, name)):
                word = self.source.text[span.start : span.end]
                self.diagnostics.append(self.source.diagnostic(span, f"{word} {reason}", "no-effect"))

    # ---- Tokens that have no place

    def unexpected(self, token: Token) -> SceneError:
        """The error about a token whose role is none of the expected ones."""
        inner = [role for role in words.ORDER if role in self.expected and role not in STATEMENTS]
        names = [name for role in inner for name in words.meanings(role)]
        if "USE" in self.expected:
            names += self.fields["solids"]
        if self.expected & STATEMENTS:
            names.append("the next statement" if inner else "a statement")
        if token.role == "":
            if "RPAR" in self.expected:
                return self.source.error(self.open, "this '(' is not closed", "unclosed")
            reason = f"the file ends after this; expected {listing(names)}"
            return self.source.error(self.scanner.last.span, reason, "unexpected-end")
        before = [one for one in self.tokens[-40:] if one.role != "COMMENT"][:-1]
        return self.source.error(token.span, *self.reason(token, before, listing(names)))

    def reason(self, token: Token, before: list[Token], names: str) -> tuple[str, str]:
        """What to say of an unexpected token, and its code; ``names``: what has a place where it stands."""
        word, found = token.text, f"found {quote(token.text)}"
        if text := of_mark(self.source.text, token.start, word):
            return f"{found}; {text}", "foreign"
        if token.role == "EQUALS":
            return f"{found}, which may only follow a keyword", "unexpected"
        if self.expected == {"VARIABLE"}:
            return f"{found}; expected a name, such as $angle", "unexpected"
        number = "NUMBER" in self.expected and token.role in (*words.OPERATORS.values(), "WORD")
        if mistake := _meant_as_number(word, before) if number else "":
            return found + mistake, "not-a-number"
        if named := self.several_words(token, before):
            return f"{found} after a name; expected one word, or more in quotes: {named}", "name"
        lacking = self.lacking(before)
        within = row(self.keyword.role, self.keyword.text).name if self.keyword.role else ""
        if token.role == "WORD":
            fitting = self.expected & {"BOOL"} if lacking else self.expected
            solids = list(self.fields["solids"]) if "USE" in fitting else []
            near = nearest(word, solids) or meant(word, set(fitting), within)
            near = BRACES if lacking and ARITHMETIC.search(word) else near
            return f"unknown word {quote(word)}{lacking or f'; expected {names}'}{near}", "unknown-word"
        if lacking:
            return found + lacking, "count"
        if "RPAR" in self.expected:
            line, column = self.source.line_column(self.open.start)
            reason = f"{found}; expected ')' before it: the '(' on line {line}, column {column} is not closed"
            return reason, "unclosed"
        return found + self.misplaced(token, before, names, within), "unexpected"

    def misplaced(self, token: Token, before: list[Token], names: str, within: str) -> str:
        """What to say after ``found`` of a word that has its place elsewhere, or of a number."""
        if token.role == "NUMBER" and before and before[-1].role == "DIELECTRIC":
            return f"; expected a glass's name, or n-refr = {quote(token.text)[1:-1]}"
        if "TEXTURE_NAME" in self.expected and (near := nearest(token.text, TEXTURES)):
            return f", the kind of a texture; expected the name of one{near}"
        owner = words.STATEMENT_OF.get(token.role)
        if owner and owner != self.keyword.role:
            owner = words.canonical(owner)
            here = hint_within(token.text, within)
            return f", a word of {owner}" + (here or f"; expected it after {owner}, before any other statement")
        if token.role in words.ROLES and token.role not in STATEMENTS and "NUMBER" not in self.expected:
            near = A_LIGHT if "LIGHT" in self.expected else hint(token.text)
            return f", which has no place here; expected {names}{near}"
        return f"; expected {names}"

    def lacking(self, before: list[Token]) -> str:
        """After which keyword an unexpected token stands, and what that still lacks; nothing elsewhere."""
        rest = [token for token in before if token.role != "LPAR"]
        given = 0
        while rest and rest[-1].role in ("NUMBER", "BOOL"):
            rest.pop()
            given += 1
        takes = row(rest[-1].role, rest[-1].text).takes if rest and rest[-1].role in words.ROLES else None
        one = isinstance(takes, Numbers) and takes.channels and given < 2
        if takes is None or given >= (1 if one else takes.count):
            return ""
        return f" after {rest[-1].text}; expected {takes.counted()}"

    def several_words(self, token: Token, before: list[Token]) -> str:
        """NAME and all the words on its line, in quotes, where an unexpected token may be one of them; or nothing."""
        at = next((i for i in range(len(before) - 1, max(len(before) - 4, -1), -1) if before[i].role == "NAME"), None)
        if token.role != "WORD" or at is None or at + 1 >= len(before):
            return ""
        text, start = self.source.text, before[at + 1].start
        if "\n" in text[start : token.start]:
            return ""
        line = re.split(r'[\n"#()]', text[token.end : token.end + CLIP], maxsplit=1)[0].split()
        more = itertools.takewhile(lambda word: not (word.isupper() and words.is_statement(word)), line)
        return f'NAME "{" ".join([*text[start : token.end].split(), *more])}"'


OPERATOR = {symbol: model.Operator(symbol) for symbol in words.OPERATORS}


def _span(tokens: Sequence[Token]) -> Span:
    """From the first token to the last."""
    return Span(tokens[0].start, tokens[-1].end)


def _texture(token: Token) -> model.Texture | None:
    """What a token in a texture slot says: the name of a texture, that of an image's file, or none."""
    if token.role == "TEXTURE_NAME":
        return model.Texture(name=words.texture_name(token.text))
    return model.Texture(image=token.text) if token.role != "NULL" else None


def _out_of_range(keyword: Token, token: Token, takes: Numbers) -> str:
    """What to say after ``found`` of a number that the keyword's row does not allow."""
    value = float(token.text)
    if takes is words.INDEX and token.text.isdecimal() and len(token.text) > 9:
        return "; expected an index of 9 digits at most"
    if not math.isfinite(value):
        return "; expected a finite number"
    if takes.nonzero and value == 0:
        return "; this scale is singular, expected factors other than 0"
    scale = ""
    if takes.channels and takes.high == 1 and 1 < value <= 255:
        scale = f": a share from 0 to 1, not from 0 to 255; {token.text} of 255 is {value / 255:.3g}"
    return f" after {keyword.text}; expected {takes.bounds()}{scale}"


def _meant_as_number(word: str, before: Sequence[Token]) -> str:
    """What to say after ``found`` of a token that was most likely meant as a number; nothing of others."""
    braces = BRACES if ARITHMETIC.search(word) else ""
    if braces and before and before[-1].role == "NUMBER":
        return f" after a number{braces}"
    if normalise(word.lstrip("+-")) in ("nan", "inf", "infinity"):
        return "; expected a finite number"
    if BY.fullmatch(word):
        return f"; expected numbers with nothing but spaces between them: {' '.join(BY_SIGN.split(word))}"
    if SEPARATED.fullmatch(word):
        return (
            "; expected numbers with nothing but spaces between them, as in 1 2 3, and with a point for the fraction, "
            "as in 0.5"
        )
    if percent := PERCENT.fullmatch(word):
        return f", which is not a number; write {float(percent[1]) / 100:.10g}"
    return f", which is not a number{braces}" if word[0] in "0123456789.+-" and word not in words.OPERATORS else ""


def _infix(source: Source, nodes: Sequence[model.Operator | model.Leaf], spans: Sequence[Span]) -> str | None:
    """A tree that is written infix, A - B * C, as the language writes it: - A * B C; None for any other.

    Products go first, as everywhere.
    """
    kinds = [isinstance(node, model.Leaf) for node in nodes]
    if len(nodes) < 3 or kinds != [True, False] * (len(nodes) // 2) + [True]:
        return None
    pieces = [" ".join(source.text[start:end].split()) for start, end in spans]
    operators, leaves = pieces[1::2], pieces[::2]
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
