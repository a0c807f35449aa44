"""Reads the statements of a text, and the spans of their values: recursive descent over the roles of ``words``.

After a wrong value the reader continues. A syntax error ends its statement; the reader continues at the next line that
begins with the keyword of a statement.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from .. import model
from . import words
from .diagnostics import MAX_ERRORS, SceneError, SceneWarning, Source, Span, listing, quote
from .document import Path
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
#: Codes of syntax errors, which depend on no value.
SYNTAX = ("no-end", "tree", "infix")
OPERATOR = {symbol: model.Operator(symbol) for symbol in words.OPERATORS}


@cache
def _and_numbers(roles: frozenset[str]) -> frozenset[str]:
    return roles | {"NUMBER"}


class Reader:
    """Reads a text.

    ``fields``: its values, by the fields of a Scene, ``defaults`` and ``solids``; ``spans``: the spans of the values,
    by path; ``errors`` and ``warnings`` within its statements; ``tokens``: all tokens up to END; ``skipped``:
    whether statements are missing because of errors; ``ended``: whether END was found, or an error in its place.

    ``define``: values of names from the caller.
    """

    def __init__(self, text: str, filename: str = "<string>", define: Mapping[str, object] | None = None) -> None:
        self.source = Source(text, filename)
        self.definitions = Definitions(self.source, define)
        self.scanner = Scanner(self.source, self.definitions)
        self.fields: dict[str, Any] = {"defaults": {}, "solids": {}, "surfaces": {}, "transforms": {}, "patterns": {}}
        self.spans: dict[Path, Span] = {}
        self.errors: list[SceneError] = []
        self.warnings: list[SceneWarning] = []
        self.skipped = self.ended = self.has_undefined = False
        #: The last token, and the roles that were expected there.
        self.token, self.expected = START, NEXT
        #: The keyword of the present statement, and the path of its value.
        self.keyword, self.path = START, Path()
        #: The present values: their keyword and the allowed numbers; their tokens so far; the parenthesis around them.
        self.takes: tuple[str, Numbers] | None = None
        self.taken, self.parenthesis = list[Token](), Span(0, 0)
        self.statements()

    @property
    def tokens(self) -> list[Token]:
        """All tokens up to END, comments included, and the text after END as one REST."""
        return self.scanner.tokens

    # ---- The text, statement by statement

    def statements(self) -> None:
        """Reads all statements."""
        at_keyword = False  # whether ``token`` is the keyword of the next statement
        while len(self.errors) <= MAX_ERRORS and not self.ended:
            before, skipped = len(self.errors), self.skipped
            self.keyword = self.token if at_keyword else START
            try:
                if not at_keyword:
                    self.next(NEXT)
                    at_keyword, self.keyword = True, self.token
                if self.keyword.role in ("END", ""):
                    break
                self.store(getattr(self, self.keyword.role.lower())())
            except SceneError as error:
                at_keyword = False
                self.errors[before:] = [error]
                self.skip(error)
            if self.scanner.undefined:
                self.undefined(before, skipped)
        cut = len(self.errors) > MAX_ERRORS
        self.skipped, self.ended = self.skipped or cut, self.ended or cut or self.token.role == "END"
        if self.token.role == "END" and (rest := self.scanner.rest()):
            reason = "the text after END is ignored; delete it"
            self.warnings.append(self.source.warning(rest.span, reason, "after-end"))

    def store(self, value: Any) -> None:
        """Stores the value of a statement, unless it is a duplicate, or its index is wrong."""
        field, *index = self.path
        if not index:
            self.fields[str(field)] = value
        elif field in self.fields:
            self.fields[str(field)][index[0]] = value

    def skip(self, error: SceneError) -> None:
        """Continues at the next line that begins with the keyword of a statement."""
        start = max(error.span.start if error.span else 0, self.keyword.start)
        after = STATEMENT_LINE.search(self.source.text, start + 1)
        self.scanner.position = after.start() if after else len(self.source.text)
        while self.tokens and self.tokens[-1].end > self.scanner.position:
            self.tokens.pop()
        self.skipped, self.ended, self.token = True, after is None, START

    def undefined(self, before: int, skipped: bool) -> None:
        """Reports the names without values in a statement, each once, instead of the errors in the statement's values.

        They are not reported after a statement that was ``skipped``: it may have been their definition.
        """
        new = [one for one in self.scanner.undefined if one not in self.errors]
        kept = [one for one in self.errors[before:] if self.skipped or one.code in SYNTAX]
        self.errors[before:] = kept if skipped else [*new, *kept]
        self.scanner.undefined, self.has_undefined = {}, True

    # ---- Tokens

    def next(self, expected: frozenset[str]) -> str:
        """Reads the next token and returns its role, one of the expected ones; otherwise raises SceneError."""
        self.expected = expected
        self.token = token = self.scanner.next(expected, self.keyword.role)
        if token.role not in expected:
            if "USE" not in expected or normalise(token.text) not in self.fields["solids"]:
                raise self.unexpected(token)
            self.token = self.tokens[-1] = self.scanner.last = token._replace(role="USE")
        return self.token.role

    def report(self, span: Span, reason: str, code: str) -> None:
        """Adds an error."""
        self.errors.append(self.source.error(span, reason, code))

    def begin(self, *path: str | int, at: Token | None = None) -> None:
        """Sets the path of the statement's value, with the span of the keyword or of ``at``; reports a duplicate."""
        kind, token = self.keyword.role, at or self.keyword
        self.path = path
        if path in self.spans:
            name = self.keyword.text if kind == "SETTING" else words.canonical(kind)
            self.note_once(token, " ".join([name, *(f"{'$' * (kind == 'DEFAULT')}{key}" for key in path[1:])]))
            self.path = "twice", token.start
        self.note(token.span)

    def note(self, span: Span, *path: str | int) -> None:
        """Stores the span of the statement's value, or of a part of it."""
        whole = (*self.path, *path)
        self.spans[whole] = span

    def note_once(self, token: Token, what: str, *path: str | int) -> None:
        """Stores the span of a part; reports a duplicate."""
        whole = (*self.path, *path)
        if first := self.spans.get(whole):
            reason = f"{what} is given twice; the first is on line {self.source.line(first)}; delete one"
            self.report(token.span, reason, "twice")
        else:
            self.spans[whole] = token.span

    # ---- Values

    def value(self, keyword: Token, follow: frozenset[str], *first: Token) -> Any:
        """The value of the numbers, or TRUE and FALSE, after a keyword, by its row; None if it is wrong.

        ``first`` are tokens that have been read. The token after the values has a role of ``follow``.
        """
        takes = words.INDEX if keyword.role == "USE" else row(keyword.role, keyword.text).takes
        self.takes, self.taken = (keyword.text, takes), [*first, *self.scanner.plain_numbers()]
        expected = _and_numbers(follow)
        while self.next(expected) in ("NUMBER", "BOOL"):
            self.taken.append(self.token)
        self.takes = None
        return self.checked(keyword, takes)

    def checked(self, keyword: Token, takes: Numbers) -> Any:
        """The value of the tokens in ``taken`` after a keyword; reports an error and returns None if it is wrong."""
        tokens = self.taken
        value = takes.value([token.text for token in tokens])
        if value is not None:
            return value
        first, last = (tokens[0], tokens[-1]) if tokens else (keyword, keyword)
        wrong = next((token for token in tokens if not takes.allow(token.text)), None)
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
        self.next(VARIABLE)
        name = self.token
        self.next(VALUE)
        value = self.token.text
        self.begin("defaults", name.text[1:], at=name)
        self.next(NEXT)
        self.definitions.default(name.text[1:], value)
        return value

    def setting(self) -> Any:
        """A statement of one keyword and its values."""
        word = row(self.keyword.role, self.keyword.text)
        self.begin(word.name)
        return self.value(self.keyword, FLAGS if isinstance(word.takes, Flags) else NEXT)

    def name(self) -> str:
        """NAME."""
        self.begin("name")
        self.next(NAMES)
        token = self.token
        self.note(token.span, "text")
        self.next(NEXT)
        return token.text

    def background(self) -> model.Background:
        """BACKGROUND."""
        self.begin("background")
        color, image = self.value(self.keyword, IMAGE), None
        if self.token.role in FILE:
            self.note(self.token.span, "image")
            image = self.token.text
        if self.token.role not in NEXT:
            self.next(NEXT)
        return model.Background(color, image)

    def lights(self) -> tuple[model.Light, ...]:
        """LIGHTS."""
        self.begin("lights")
        lights: list[model.Light] = []
        self.next(LIGHTS)
        while self.token.role == "LIGHT":
            kind = row("LIGHT", self.token.text).name
            self.note(self.token.span, len(lights))
            if kind == "sky":
                self.next(FILE)
                self.note(self.token.span, len(lights), "image")
                values: dict[str, Any] = {"image": self.token.text}
                self.next(LIGHTS)
            else:
                self.next(LIGHT)
                values = self.parameters(LIGHT, len(lights))
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
        self.skipped = self.skipped or index is None
        self.begin(*((field, index) if index is not None else ("wrong", self.keyword.start)))

    def surface(self) -> model.Surface:
        """SURFACE."""
        self.index("surfaces", SURFACE)
        return model.Surface(**self.parameters(SURFACE))

    def material(self, values: dict[str, Any]) -> None:
        """``material`` and its kind, with the name of a metal or glass after some, or ``metal`` and its name."""
        kind = self.token
        if kind.role == "MATERIAL":
            self.note_once(kind, "the material", "material")
            self.next(MATERIAL)
            kind = self.token
            values["material"] = row(kind.role, kind.text).name
            if self.next(SURFACE | WORD if kind.role in NAMED else SURFACE) != "WORD":
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
            role = self.next(STEP)
            if role == "LPAR":
                self.parenthesis = self.token.span
                value = self.value(keyword, ARGUMENT)
                self.next(TRANSFORM)
            elif role == "NUMBER":
                value = self.value(keyword, TRANSFORM, self.token)
            else:
                self.taken, value = [], None
                self.checked(keyword, row("STEP", keyword.text).takes)
            steps.append(model.Step(row("STEP", keyword.text).name, value if isinstance(value, tuple) else (value,)))
        return model.Transform(tuple(steps))

    def texture(self) -> model.Pattern:
        """TEXTURE."""
        self.next(TEXTURE_NAME)
        name, values = words.texture_name(self.token.text), dict[str, Any]()
        self.begin("patterns", name, at=self.token)
        kind = words.BUILT_IN.get(name, "")
        if self.next(TEXTURE | {"KIND"}) == "KIND":
            word = self.token
            given = row("KIND", word.text).name
            if self.next(TEXTURE | {"NUMBER"} if given == "brick" else TEXTURE) == "NUMBER":  # a parameter, too
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
        self.next(WORD)
        token = self.token
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
        role = self.next(TREE)
        while role not in NEXT:
            if role in ("PRIMITIVE", "USE"):
                nodes += [self.leaf(len(nodes))] if role == "PRIMITIVE" else self.use(len(nodes))
                role = self.token.role
            else:
                self.note(self.token.span, len(nodes))
                nodes.append(OPERATOR[self.token.text])
                role = self.next(TREE)
        for token in self.tokens[first:] if not nodes else ():
            if token.role == "COMMENT" and token.text[0] == "(" and PRIMITIVE.search(token.text):
                raise self.source.error(token.span, f"this tree is a comment; {PREFIX}", "tree-in-comment")
        if len(self.errors) == before:
            self.check_tree([isinstance(node, model.Operator) for node in nodes])
        return tuple(nodes) if len(self.errors) == before else ()

    def check_tree(self, operators: list[bool]) -> None:
        """Reports the first node after the tree is complete, or an operator that lacks operands."""
        missing = 1
        for number, is_operator in enumerate(operators):
            if not missing:
                spans = [
                    self.spans[path] for path in [(*self.path, i) for i in (number, 0, min(2, len(operators) - 1))]
                ]
                found, first, second = (" ".join(self.source.text[slice(*span)].split()) for span in spans)
                if operators[:3] == [False, True, False]:
                    reason = f"found {quote(found)} between its operands; expected it before them: "
                    self.report(spans[0], f"{reason}{found} {first} {second}", "infix")
                else:
                    reason = f"found {quote(found)} after the tree is complete; expected the next statement"
                    self.report(spans[0], f"{reason}, or an operator before the operands; {PREFIX}", "tree")
                return
            missing += 1 if is_operator else -1
        operands = 0
        for number in reversed(range(len(operators) if missing else 0)):
            if operators[number] and operands < 2:
                missing_operands = ("two operands", "an operand")[operands]
                path = (*self.path, number)
                span = self.spans[path]
                reason = f"this {quote(self.source.text[slice(*span)])} lacks {missing_operands}"
                reason += "; expected a primitive or an operator"
                self.report(span, f"{reason}; {PREFIX}", "tree")
                return
            operands += -1 if operators[number] else 1

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
            self.note(self.token.span, number, "file")
            file, end = self.token.text, self.token.end
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
        roles = self.expected - {"NUMBER"} if self.takes and self.takes[1].fit(len(self.taken)) else self.expected
        inner = [role for role in words.ORDER if role in roles and role not in STATEMENTS]
        names = [name for role in inner for name in words.meanings(role)]
        names += self.fields["solids"] if "USE" in self.expected else ()
        names += ["the next statement" if inner else "a statement"] if self.expected & STATEMENTS else ()
        text, span, found = token.text, token.span, f"found {quote(token.text)}"
        reason, code = f"; expected {listing(names)}", "unexpected"
        if self.takes and not self.takes[1].fit(len(self.taken)):
            names = [self.takes[1].counted()]
            reason, code = f" after {self.takes[0]}; expected {names[0]}", "count"
        owner = words.STATEMENT_OF.get(token.role, self.keyword.role)
        if not token.role and "RPAR" in self.expected:
            return self.source.error(self.parenthesis, "this '(' is not closed; expected ')'", "unclosed")
        if not token.role:
            reason = f"the file ends after this; expected {listing(names)}"
            return self.source.error(self.scanner.last.span, reason, "unexpected-end")
        if mark := of_mark(self.source.text, token.start):
            reason, code = mark, "foreign"
        elif "NUMBER" in self.expected and token.role in LIKE_NUMBERS and LIKE_NUMBER.search(text):
            found, code = f"{quote(text)} is not a number", "not-a-number"
            reason = f"; expected {names[0]}" if self.takes and "NUMBER" in roles else ""
            reason += f"; {BRACES}" if ARITHMETIC.search(text) else ""
            reason += f"; write {float(share[1]) / 100:.10g}" if (share := SHARE.fullmatch(text)) else ""
        elif token.role == "WORD":
            if self.keyword.role == "NAME":
                reason += '; write a name of several words in quotes: NAME "a red ball"'
            solids = self.fields["solids"] if "USE" in roles else ()
            near = nearest(text, solids) or meant(text, roles & {"BOOL"} if code == "count" else roles)
            found, code, reason = f"unknown word {quote(text)}", "unknown-word", reason + near
        elif code == "count":
            pass
        elif "RPAR" in self.expected:
            line, column = self.source.line_column(self.parenthesis.start)
            reason = f"; expected ')' before it: the '(' on line {line}, column {column} is not closed"
            code = "unclosed"
        else:
            if owner != self.keyword.role and inner and self.expected & STATEMENTS:
                found += f", a word of {words.canonical(owner)}"
                reason = f"; expected it after {words.canonical(owner)}, before the next statement"
            near = nearest(text, TEXTURES) if "TEXTURE_NAME" in self.expected else ""
            reason += near or hint(text)
        return self.source.error(span, found + reason, code)


def _texture(token: Token) -> model.Texture | None:
    """The texture in a slot: its name, the name of an image's file, or none."""
    if token.role == "TEXTURE_NAME":
        return model.Texture(name=words.texture_name(token.text))
    return model.Texture(image=token.text) if token.role != "NULL" else None
