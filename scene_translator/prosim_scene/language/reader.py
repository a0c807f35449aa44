"""Reads the statements of a text, and the spans of their values: recursive descent over the roles of ``words``.

After a wrong value the reader continues. A syntax error ends its statement; the reader continues at the next line that
begins with the keyword of a statement.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from .. import model
from . import words
from .diagnostics import MAX_ERRORS, SceneError, SceneWarning, Source, Span, listing, quote
from .document import Path, subtree_ends
from .expressions import Definitions
from .suggestions import ARITHMETIC, BRACES, NUMBER, TEXTURES, hint, meant, nearest, of_mark, unknown_name
from .tokens import START, Scanner, Token
from .words import NAMED, STATEMENTS, Flags, Numbers, normalise, row

#: The largest number of nodes of a tree with named solids.
MAX_NODES = 10**5
#: A line that begins with the keyword of a statement.
STATEMENT_LINE = re.compile(
    rf"^[ \t]*(?:{'|'.join(sorted(map(re.escape, words.spellings(*STATEMENTS)), key=len, reverse=True))})(?![\w.-])",
    re.IGNORECASE | re.MULTILINE,
)
#: The roles that each statement expects, and those after it.
NEXT = STATEMENTS | {""}
NAMES = frozenset(("WORD", "STRING", "FILE", "TEXTURE_NAME", "NUMBER"))
VALUE = frozenset(("NUMBER", "WORD", "STRING"))
WORD, VARIABLE, ARGUMENT = frozenset(("WORD",)), frozenset(("VARIABLE",)), frozenset(("RPAR",))
FLAGS = NEXT | {"BOOL"}
FILE = frozenset(("FILE", "STRING"))
IMAGE = NEXT | {"FILE", "STRING", "NULL"}
LIGHTS = NEXT | {"LIGHT"}
LIGHT = LIGHTS | {"LIGHT_PARAMETER", "DISTRIBUTION"}
VIEW = NEXT | {"VIEW_PARAMETER"}
TREE = NEXT | {"PLUS", "MINUS", "TIMES", "PRIMITIVE", "USE"}  # USE: the name of a solid
SLOTS = TREE | {"TEXTURE_NAME", "FILE", "STRING", "NULL"}
SURFACE = NEXT | {"MATERIAL", "METAL", "OPTIC"}
MATERIAL = frozenset(("MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC"))
TRANSFORM = NEXT | {"STEP"}
STEP = TRANSFORM | {"NUMBER", "LPAR"}
TEXTURE = NEXT | {"PARAMETER"}
TEXTURE_NAME = frozenset(("TEXTURE_NAME",))

#: A comment in the place of the values of a keyword.
COMMENT = re.compile(r"[\s:=]*(\([^()\n]*\)|#\w+)")
SHARE = re.compile(rf"({NUMBER})%")
PRIMITIVE = re.compile(rf"(?:{'|'.join(words.spellings('PRIMITIVE'))})\s+\d+", re.IGNORECASE)
PREFIX = "operators come before their operands, as in - CUBE 1 SPHERE 2, and parentheses are comments"
#: Tokens that look like numbers, or like arithmetic.
LIKE_NUMBERS = ("WORD", *words.OPERATORS.values())
LIKE_NUMBER = re.compile(rf"^[-+.0-9]|{ARITHMETIC.pattern}")
OPERATOR = {symbol: model.Operator(symbol) for symbol in words.OPERATORS}


@cache
def _and_numbers(roles: frozenset[str]) -> frozenset[str]:
    return roles | {"NUMBER"}


class Reader:
    """Reads a text.

    ``fields``: its values, by the fields of a Scene, ``defaults`` and ``solids``; ``spans``: the spans of the values,
    by path; ``errors`` and ``warnings`` within its statements; ``tokens``: all tokens up to END, comments included,
    and the text after END as one REST; ``skipped``: the offset from which statements are missing because of errors.

    ``define``: values of names from the caller.
    """

    def __init__(self, text: str, filename: str = "<string>", define: Mapping[str, object] | None = None) -> None:
        self.source = Source(text, filename)
        self.definitions = Definitions(self.source, define)
        self.scanner = Scanner(self.source, self.definitions)
        self.tokens = self.scanner.tokens
        self.fields: dict[str, Any] = {"defaults": {}, "solids": {}, "surfaces": {}, "transforms": {}, "patterns": {}}
        self.spans: dict[Path, Span] = {}
        self.errors: list[SceneError] = []
        self.warnings: list[SceneWarning] = []
        self.skipped = math.inf
        #: The last token, and the roles that were expected there.
        self.token, self.expected = START, NEXT
        #: The keyword of the present statement, and the path of its value.
        self.keyword, self.path = START, Path()
        #: The present values: their keyword and the allowed numbers; their tokens so far; the parenthesis around them.
        self.takes: tuple[str, Numbers] | None = None
        self.taken, self.parenthesis = list[Token](), Span(0, 0)
        self.statements()

    # ---- The text, statement by statement

    def statements(self) -> None:
        """Reads all statements."""
        at_end = False
        while not at_end and len(self.errors) <= MAX_ERRORS:
            before, self.keyword = len(self.errors), self.token
            try:
                if self.keyword is START:
                    self.next(NEXT)
                    self.keyword = self.token
                at_end = self.keyword.role in ("END", "")
                if at_end:
                    self.end()
                else:
                    self.store(getattr(self, self.keyword.role.lower())())
            except SceneError as error:
                self.errors[before:] = [error]
                at_end = not self.skip(error)
        if not at_end:
            self.skipped = min(self.skipped, self.scanner.position)

    def end(self) -> None:
        """END and the text after it, or the end of the text."""
        if not self.keyword.role:
            reason = "the file ends here and END is missing; expected END as the last statement"
            self.report(self.scanner.last.span, reason, "no-end")
        elif rest := self.scanner.rest():
            reason = "the text after END is ignored; delete it"
            self.warnings.append(self.source.warning(rest.span, reason, "after-end"))

    def store(self, value: Any) -> None:
        """Stores the value of a statement, unless it is a duplicate, or its index is wrong."""
        field, *key = self.path
        if key:
            self.fields.get(str(field), {})[key[0]] = value
        else:
            self.fields[str(field)] = value

    def skip(self, error: SceneError) -> bool:
        """Continues at the next line that begins with the keyword of a statement; returns whether there is one."""
        start = max(error.span.start if error.span else 0, self.keyword.start)
        after = STATEMENT_LINE.search(self.source.text, start + 1)
        self.scanner.position = after.start() if after else len(self.source.text)
        while self.tokens and self.tokens[-1].end > self.scanner.position:
            self.tokens.pop()
        self.skipped, self.token = min(self.skipped, start), START
        return after is not None

    # ---- Tokens

    def next(self, expected: frozenset[str]) -> Token:
        """Reads the next token, whose role is one of the expected ones; otherwise raises SceneError."""
        self.expected = expected
        self.token = token = self.scanner.next(expected, self.keyword.role)
        if token.role not in expected:
            if "USE" not in expected or normalise(token.text) not in self.fields["solids"]:
                raise self.unexpected(token)
            self.token = self.tokens[-1] = self.scanner.last = token._replace(role="USE")
        return self.token

    def report(self, span: Span, reason: str, code: str) -> None:
        """Adds an error."""
        self.errors.append(self.source.error(span, reason, code))

    def begin(self, *path: str | int, at: Token | None = None) -> None:
        """Sets the path of the statement's value, with the span of the keyword or of ``at``; reports a duplicate."""
        token, self.path = at or self.keyword, path
        if path in self.spans:
            self.note_once(token, " ".join(map(str, [self.keyword.text, *([at.text] if at else path[1:])])))
            self.path = "duplicate", token.start
        self.note(token.span)

    def note(self, span: Span, *path: str | int) -> None:
        """Stores the span of the statement's value, or of a part of it."""
        path = (*self.path, *path)
        self.spans[path] = span

    def note_once(self, token: Token, what: str, *path: str | int) -> None:
        """Stores the span of a part; reports a duplicate."""
        path = (*self.path, *path)
        if first := self.spans.get(path):
            reason = f"{what} stands twice; the first is on line {self.source.line(first)}; delete one"
            self.report(token.span, reason, "twice")
        else:
            self.spans[path] = token.span

    # ---- Values

    def value(self, keyword: Token, follow: frozenset[str], first: Token | None = None) -> Any:
        """The value of the numbers, or TRUE and FALSE, after a keyword, by its row; None if it is wrong.

        ``first`` is the token after the keyword if it has been read. That after the values has a role of ``follow``.
        """
        takes = words.INDEX if keyword.role == "USE" else row(keyword.role, keyword.text).takes
        self.takes, self.taken = (keyword.text, takes), [first] if first and first.role == "NUMBER" else []
        if self.taken or not first:
            self.taken += self.scanner.plain_numbers()
            expected = _and_numbers(follow)
            while self.next(expected).role in ("NUMBER", "BOOL"):
                self.taken.append(self.token)
        self.takes = None
        return self.checked(keyword, takes)

    def checked(self, keyword: Token, takes: Numbers) -> Any:
        """The value of the tokens in ``taken`` after a keyword; reports an error and returns None if it is wrong."""
        tokens = self.taken
        if self.definitions.undefined and any(self.source.text[token.start] in "${" for token in tokens):
            return None  # the error is that about the name
        value = takes.value([token.text for token in tokens])
        if value is not None:
            return value
        first, last = (tokens[0], tokens[-1]) if tokens else (keyword, keyword)
        wrong = next((token for token in tokens if not takes.allow(takes.number(token.text))), None)
        if not takes.fit(len(tokens)):
            noun = takes.noun + "s" * (len(tokens) != 1)
            reason = f"found {len(tokens)} {noun} after {keyword.text}; expected {takes.counted()}"
            if comment := COMMENT.match(self.source.text, last.end):
                reason += f"; {quote(comment[1])} is a comment; write the numbers without parentheses and commas"
            self.report(Span(first.start, last.end), reason, "count")
        elif wrong:
            reason = f"found {quote(wrong.text)} after {keyword.text}; expected {takes.bounds()}"
            if takes.channels and takes.high == 1 < float(wrong.text) <= 255:
                reason += f"; {wrong.text} of 255 is {float(wrong.text) / 255:.3g}"
            self.report(wrong.span, reason, "range")
        else:
            self.report(first.span, f"{keyword.text} has length 0; expected a direction", "range")
        return None

    def parameters(self, follow: frozenset[str], *owner: str | int) -> dict[str, Any]:
        """The values of the parameters that begin at this token, by their names in the model."""
        values: dict[str, Any] = {}
        while (keyword := self.token).role in follow and keyword.role not in LIGHTS:
            word = row(keyword.role, keyword.text)
            if keyword.role == "DISTRIBUTION":
                self.note_once(keyword, "the distribution of a light", *owner, "distribution")
                values["distribution"] = word.name
                self.next(follow)
            elif not word.takes.count:
                self.material(values)
            else:
                self.note_once(keyword, keyword.text, *owner, word.name)
                if word.name in ("exponent", "slope") and keyword.role == "OPTIC":
                    self.note_once(keyword, "the roughness", "roughness")
                values[word.name] = self.value(keyword, follow | {"MINUS"} if word.name == "vrp" else follow)
                if keyword.role == "VIEW_PARAMETER":
                    self.note(Span(keyword.start, (self.taken or [keyword])[-1].end), word.name)
                if self.token.role == "MINUS":  # the stray dash of the thesis's listing
                    self.next(follow)
        return values

    # ---- Statements, by the roles of their keywords. Each returns its value; ``token`` is then the next keyword.

    def default(self) -> str:
        """DEFAULT."""
        name, value = self.next(VARIABLE), self.next(VALUE)
        self.begin("defaults", name.text[1:], at=name)
        self.next(NEXT)
        self.definitions.default(name.text[1:], value.text)
        return value.text

    def setting(self) -> Any:
        """A statement of one keyword and its values."""
        word = row(self.keyword.role, self.keyword.text)
        self.begin(word.name)
        return self.value(self.keyword, FLAGS if isinstance(word.takes, Flags) else NEXT)

    def name(self) -> str:
        """NAME."""
        self.begin("name")
        token = self.next(NAMES)
        self.note(token.span, "text")
        self.next(NEXT)
        return token.text

    def file(self, *path: str | int) -> str:
        """The name of a file: the present token, a part of the statement's value."""
        self.note(self.token.span, *path)
        return self.token.text

    def background(self) -> model.Background:
        """BACKGROUND."""
        self.begin("background")
        color = self.value(self.keyword, IMAGE)
        image = self.file("image") if self.token.role in FILE else None
        if self.token.role not in NEXT:
            self.next(NEXT)
        return model.Background(color, image)

    def lights(self) -> tuple[model.Light, ...]:
        """LIGHTS."""
        self.begin("lights")
        lights: list[model.Light] = []
        self.next(LIGHTS)
        while (token := self.token).role == "LIGHT":
            kind, number, values = row("LIGHT", token.text).name, len(lights), dict[str, Any]()
            self.note(token.span, number)
            if kind == "sky":
                self.next(FILE)
                values["image"] = self.file(number, "image")
            self.next(LIGHTS if kind == "sky" else LIGHT)
            values |= self.parameters(LIGHT, number)
            if values.get("distribution") == "cone":
                values.setdefault("angle", 30.0)
            lights.append(model.Light(kind, **values))
        return tuple(lights)

    def view(self) -> model.View:
        """VIEW."""
        self.begin("view")
        self.next(VIEW)
        return model.View(**self.parameters(VIEW))

    def index(self, field: str, follow: frozenset[str]) -> None:
        """The index after SURFACE or TRANSFORM."""
        index = self.value(self.keyword, follow)
        if index is None and not self.definitions.undefined:
            self.skipped = min(self.skipped, self.keyword.start)
        self.begin(*(("unknown", self.keyword.start) if index is None else (field, index)))

    def surface(self) -> model.Surface:
        """SURFACE."""
        self.index("surfaces", SURFACE)
        return model.Surface(**self.parameters(SURFACE))

    def material(self, values: dict[str, Any]) -> None:
        """``material`` and its kind, with the name of a metal or glass after some, or ``metal`` and its name."""
        kind = self.token
        if kind.role == "MATERIAL":
            self.note_once(kind, "the material", "material")
            kind = self.next(MATERIAL)
            values["material"] = row(kind.role, kind.text).name
            if self.next(SURFACE | WORD if kind.role in NAMED else SURFACE).role != "WORD":
                return
        else:
            self.next(WORD)
            values.setdefault("material", "conductor")
        name, (field, table) = self.token, NAMED[kind.role]
        if normalise(name.text) not in table and not name.text.startswith("$"):
            raise self.source.error(name.span, unknown_name(kind.role, name.text), "unknown-name")
        self.note_once(name, f"the {field}", field)
        values[field] = table.get(normalise(name.text))
        self.next(SURFACE)

    def transform(self) -> model.Transform:
        """TRANSFORM."""
        self.index("transforms", TRANSFORM)
        steps = []
        while (keyword := self.token).role == "STEP":
            if self.next(STEP).role == "LPAR":
                self.parenthesis = self.token.span
                value = self.value(keyword, ARGUMENT)
                self.next(TRANSFORM)
            else:
                value = self.value(keyword, TRANSFORM, self.token)
            steps.append(model.Step(row("STEP", keyword.text).name, value if isinstance(value, tuple) else (value,)))
        return model.Transform(tuple(steps))

    def texture(self) -> model.Pattern:
        """TEXTURE."""
        name, values = words.texture_name(self.next(TEXTURE_NAME).text), dict[str, Any]()
        self.begin("patterns", name, at=self.token)
        kind = words.BUILT_IN.get(name, "")
        if (word := self.next(TEXTURE | {"KIND"})).role == "KIND":
            given = row("KIND", word.text).name
            if self.next(TEXTURE | {"NUMBER"} if given == "brick" else TEXTURE).role == "NUMBER":  # a parameter, too
                self.note(word.span, given)
                values[given] = self.value(word._replace(role="PARAMETER"), TEXTURE, self.token)
            else:
                kind = given
        values |= self.parameters(TEXTURE)
        return model.Pattern(kind, tuple(sorted(values.items())))

    def csg_tree(self) -> tuple[model.Operator | model.Leaf, ...]:
        """CSG-TREE."""
        self.begin("csg")
        return self.tree()

    def solid(self) -> tuple[model.Operator | model.Leaf, ...]:
        """SOLID: a tree with a name."""
        token = self.next(WORD)
        self.begin("solids", normalise(token.text), at=token)
        if normalise(token.text) in words.ROWS:
            reason = f"found {quote(token.text)}, a word of the language; expected another name"
            self.report(token.span, reason, "name")
        before, nodes = len(self.errors), self.tree()
        if not nodes and len(self.errors) == before:
            self.report(token.span, f"this solid is empty; expected its tree after {token.text}", "incomplete")
        return nodes

    def tree(self) -> tuple[model.Operator | model.Leaf, ...]:
        """Operators and primitives in prefix order; the nodes of a named solid replace its name."""
        before, first = len(self.errors), len(self.tokens)
        nodes: list[model.Operator | model.Leaf] = []
        self.next(TREE)
        while (token := self.token).role not in NEXT:
            if token.role == "PRIMITIVE":
                nodes.append(self.leaf(len(nodes)))
            elif token.role == "USE":
                nodes += self.use(len(nodes))
            else:
                self.note(token.span, len(nodes))
                nodes.append(OPERATOR[token.text])
                self.next(TREE)
        for token in self.tokens[first:] if not nodes else ():
            if token.role == "COMMENT" and token.text[0] == "(" and PRIMITIVE.search(token.text):
                raise self.source.error(token.span, f"this tree is a comment; {PREFIX}", "tree-in-comment")
        if nodes and len(self.errors) == before:
            self.check_tree(nodes)
        return tuple(nodes) if len(self.errors) == before else ()

    def check_tree(self, nodes: list[model.Operator | model.Leaf]) -> None:
        """Reports the first node after the tree is complete, or the last operator that lacks operands."""
        ends, count = subtree_ends(nodes), len(nodes)
        spans = [self.spans[path] for path in ((*self.path, i) for i in range(count))]
        if ends[0] < count:
            places = (spans[i] for i in (ends[0], 0, min(2, count - 1)))
            found, first, second = (" ".join(self.source.text[slice(*span)].split()) for span in places)
            if (
                isinstance(nodes[1], model.Operator)
                and ends[0] == 1
                and isinstance(nodes[min(2, count - 1)], model.Leaf)
            ):
                reason, code = f"between its operands; expected it before them: {found} {first} {second}", "infix"
            else:
                reason = "after the tree is complete; expected the next statement, or an operator before the operands"
                reason, code = f"{reason}; {PREFIX}", "tree"
            self.report(spans[ends[0]], f"found {quote(found)} {reason}", code)
        elif ends[0] > count:
            number = max(i for i, end in enumerate(ends) if end > count)
            lacking = "two operands" if number == count - 1 else "an operand"
            reason = f"this {quote(self.source.text[slice(*spans[number])])} lacks {lacking}"
            self.report(spans[number], f"{reason}; expected a primitive or an operator; {PREFIX}", "tree")

    def use(self, number: int) -> list[model.Operator | model.Leaf]:
        """The nodes of a named solid in a tree, with its index."""
        keyword, solid = self.token, self.fields["solids"][normalise(self.token.text)]
        index = self.value(keyword, TREE)
        if number + len(solid) > MAX_NODES:
            reason = f"found a tree of more than {MAX_NODES} nodes; expected fewer uses of {keyword.text}"
            raise self.source.error(keyword.span, reason, "range")
        span = Span(keyword.start, (self.taken or [keyword])[-1].end)
        for i in range(len(solid)):
            self.note(span, number + i)
        within = () if index is None else (index,)
        return [replace(n, within=n.within + within) if isinstance(n, model.Leaf) else n for n in solid]

    def leaf(self, number: int) -> model.Leaf:
        """A primitive, its index, a mesh's file, and its texture slots."""
        keyword = self.token
        slots: list[model.Texture | None] = []
        shape, file = row("PRIMITIVE", keyword.text).name, None
        index = self.value(keyword, FILE if shape == "mesh" else SLOTS)
        end = (self.taken or [keyword])[-1].end
        if shape == "mesh":
            file, end = self.file(number, "file"), self.token.end
            self.next(SLOTS)
        while (token := self.token).role not in TREE:
            if len(slots) == 2:
                reason = f"found {quote(token.text)}, a third texture; expected two at most"
                self.report(token.span, reason, "count")
            self.note(token.span, number, "textures", len(slots))
            slots.append(_texture(token))
            end = token.end
            self.next(SLOTS)
        self.note(Span(keyword.start, end), number)
        textures = (slots[0], slots[1] if len(slots) > 1 else None) if slots else (None, None)
        return model.Leaf(shape, -1 if index is None else index, textures, file=file)

    # ---- Syntax errors

    def unexpected(self, token: Token) -> SceneError:
        """The error about a token with an unexpected role."""
        takes, roles, code = self.takes, self.expected, "unexpected"
        lacking = takes is not None and not takes[1].fit(len(self.taken))
        if takes and not lacking:
            roles -= {"NUMBER"}
        inner = [role for role in words.ORDER if role in roles and role not in STATEMENTS]
        names = [name for role in inner for name in words.meanings(role)]
        names += self.fields["solids"] if "USE" in roles else ()
        names += ["the next statement" if inner else "a statement"] if roles & STATEMENTS else ()
        text, span, found = token.text, token.span, f"found {quote(token.text)}"
        reason = f"; expected {listing(names)}"
        if takes and lacking:
            names, code = [takes[1].counted()], "count"
            reason = f" after {takes[0]}; expected {names[0]}"
        if not token.role and "RPAR" in roles:
            return self.source.error(self.parenthesis, "this '(' is not closed; expected ')'", "unclosed")
        if not token.role:
            reason = f"the file ends after this; expected {listing(names)}"
            return self.source.error(self.scanner.last.span, reason, "unexpected-end")
        if mark := of_mark(self.source.text, token.start):
            reason, code = mark, "foreign"
        elif "NUMBER" in self.expected and token.role in LIKE_NUMBERS and LIKE_NUMBER.search(text):
            found, code = f"{quote(text)} is not a number", "not-a-number"
            reason = f"; expected {names[0]}" if takes and "NUMBER" in roles else ""
            reason += f"; {BRACES}" if ARITHMETIC.search(text) else ""
            reason += f"; write {float(share[1]) / 100:.10g}" if (share := SHARE.fullmatch(text)) else ""
        elif token.role == "WORD":
            near = nearest(text, self.fields["solids"] if "USE" in roles else ())
            near = near or meant(text, roles & {"BOOL"} if lacking else roles)
            if self.keyword.role == "NAME":
                near = '; write a name of several words in quotes: NAME "a red ball"' + near
            found, code, reason = f"unknown word {quote(text)}", "unknown-word", reason + near
        elif "RPAR" in roles and not lacking:
            line, column = self.source.line_column(self.parenthesis.start)
            reason = f"; expected ')' before it: the '(' on line {line}, column {column} is not closed"
            code = "unclosed"
        elif not lacking:
            owner = words.STATEMENT_OF.get(token.role)
            if owner and owner != self.keyword.role and inner and roles & STATEMENTS:
                found += f", a word of {words.canonical(owner)}"
                reason = f"; expected it after {words.canonical(owner)}, before the next statement"
            reason += (nearest(text, TEXTURES) if "TEXTURE_NAME" in roles else "") or hint(text)
        return self.source.error(span, found + reason, code)


def _texture(token: Token) -> model.Texture | None:
    """The texture in a slot: its name, the name of an image's file, or none."""
    if token.role == "TEXTURE_NAME":
        return model.Texture(name=words.texture_name(token.text))
    return model.Texture(image=token.text) if token.role != "NULL" else None
