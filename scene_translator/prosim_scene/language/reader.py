"""Reads the statements of a scene and the position of each value in the text.

The reader is a recursive-descent parser over the grammar roles of tokens, which the module ``words`` defines. After a
wrong value the reader continues with the same statement. After a syntax error the reader skips the rest of the
statement, and continues at the next line that begins with the keyword of a statement.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from .. import model
from . import words
from .diagnostics import MAX_ERRORS, SceneError, SceneWarning, Source, Span, listing, quote
from .document import Path, subtree_ends
from .expressions import Definitions
from .suggestions import ARITHMETIC, BRACES, NUMBER, mark_hint, nearest, suggestion_for, unknown_name, word_hint
from .tokens import START, Scanner, Token
from .words import NAMED, STATEMENTS, Numbers, find_word, normalise

#: The largest number of primitives in all uses of named solids. A primitive counts once for each solid around it.
MAX_PRIMITIVES = 500_000
#: The nodes of a named solid whose statement has an error, so that a use of it is not another error.
WRONG_SOLID = (model.Leaf("sphere", -1),)
#: Matches the beginning of a line that starts with the keyword of a statement.
STATEMENT_LINE = re.compile(
    rf"^[ \t]*(?:{'|'.join(sorted(map(re.escape, words.spellings_of(*STATEMENTS)), key=len, reverse=True))})(?![\w.-])",
    re.IGNORECASE | re.MULTILINE,
)
#: Sets of the grammar roles that the next token may have, at different points of the grammar.
#: STATEMENT_END: the next token begins a new statement or is the end of the text ("").
STATEMENT_END = STATEMENTS | {""}
FILE = frozenset(("FILE", "STRING"))
IMAGE = STATEMENT_END | FILE | {"NULL"}
LIGHTS = STATEMENT_END | {"LIGHT"}
LIGHT = LIGHTS | {"LIGHT_PARAMETER", "DISTRIBUTION"}
METHOD = STATEMENT_END | {"CHOICE", "METHOD_PARAMETER"}
VIEW = STATEMENT_END | {"VIEW_PARAMETER"}
TREE = STATEMENT_END | {"PLUS", "MINUS", "TIMES", "PRIMITIVE", "USE"}  # USE: the name of a solid
SLOTS = TREE | FILE | {"TEXTURE_NAME", "NULL"}
SHAPE = SLOTS | {"SHAPE_PARAMETER"}
SURFACE = STATEMENT_END | {"MATERIAL", "METAL", "OPTIC"}
TRANSFORM = STATEMENT_END | {"STEP"}
STEP_VALUES, CLOSING = TRANSFORM | {"NUMBER", "LPAR"}, frozenset(("RPAR",))
TEXTURE = STATEMENT_END | {"PARAMETER"}

#: The roles of statements that set one value of several, which a name or an index after the keyword selects.
KEYED = frozenset(("DEFAULT", "SOLID", "SURFACE", "TRANSFORM", "TEXTURE"))

#: Matches a comment that stands where the values of a keyword should be.
COMMENT = re.compile(r"[\s:=]*(\([^()\n]*\)|#\w+)")
#: Matches the comments and the white space at the beginning of a text.
COMMENTS = re.compile(r"\A(?:\s|#[^\n]*(?:\n|\Z)|\((?:[^()]|\([^()]*\))*\))*")
PERCENTAGE = re.compile(rf"({NUMBER})%")
PRIMITIVE = re.compile(rf"(?:{'|'.join(words.spellings_of('PRIMITIVE'))})\s+\d+", re.IGNORECASE)
PREFIX = "operators come before their operands, as in - CUBE 1 SPHERE 2, and parentheses are comments"
#: The roles of a token that may look like a number or like arithmetic, and a pattern that matches such a token.
LIKE_NUMBERS = ("WORD", *words.OPERATORS.values())
LIKE_NUMBER = re.compile(rf"^[-+.0-9]|{ARITHMETIC.pattern}")
OPERATORS = {symbol: model.Operator(symbol) for symbol in words.OPERATORS}

Tree = tuple[model.Operator | model.Leaf, ...]


class Reader(Scanner):
    """Reads the text of a scene, and stores the values of its statements.

    ``fields`` is a dictionary of the values for the fields of a :class:`.Scene`, and of the named ``solids``. ``spans``
    maps the path of each value to the value's position in the text. ``errors`` and ``warnings`` are the problems that
    the reader finds; the module ``analysis`` finds further problems. ``skipped`` is the offset of the first part of the
    text that was skipped because of an error, or infinity if no part was skipped. All text after END is one comment,
    which is the last token in the list ``tokens``.

    ``define`` is a dictionary of the ``$names`` whose values the caller sets.
    """

    def __init__(self, text: str, filename: str = "<string>", define: Mapping[str, object] | None = None) -> None:
        """Reads the whole text, and stores its errors. Raises SceneError for a wrong ``define``."""
        source = Source(text, filename)
        super().__init__(source, Definitions(source, define))
        patterns = {name: model.Pattern(kind) for name, kind in words.BUILT_IN.items()}
        self.fields: dict[str, Any] = {"solids": {}, "surfaces": {}, "transforms": {}, "patterns": patterns}
        self.spans: dict[Path, Span] = {}
        self.errors: list[SceneError] = []
        self.warnings: list[SceneWarning] = []
        self.skipped = math.inf
        #: The number of primitives of the uses of named solids so far; :data:`MAX_PRIMITIVES` is the limit.
        self.used_primitives = 0
        #: The path of the value that the current statement sets.
        self.path = Path()
        #: While the reader reads numbers: the keyword before the numbers, and the numbers that it allows.
        self.wanted: tuple[str, Numbers] | None = None
        #: The tokens of the numbers that were read last.
        self.number_tokens: list[Token] = []
        self.read_text()

    # ---- The text, statement by statement

    def read_text(self) -> None:
        """Reads statements up to END or more than MAX_ERRORS errors. A syntax error replaces the others of its
        statement.
        """
        while len(self.errors) <= MAX_ERRORS:
            error_count, self.keyword = len(self.errors), self.token
            try:
                if self.keyword is START:
                    self.keyword = self.read_token(STATEMENT_END)
                if self.keyword.role in ("END", ""):
                    self.read_end()
                    return
                self.read_statement()
            except SceneError as error:
                # Replaces the other errors of this statement. The traceback would keep this reader in memory.
                self.errors[error_count:] = [error.with_traceback(None)]
                if not self.skip_statement(error):
                    return
        self.skipped = min(self.skipped, self.position)

    def read_end(self) -> None:
        """Reads END and the text after END, which becomes one comment. Adds a warning if the text after END contains
        more than comments. A text that ends without END is an error.
        """
        if not self.keyword.role:
            self.add_error(self.last.span, "the file ends here; expected END as the last statement", "no-end")
        elif rest := self.source.text[self.position :].lstrip():
            end = len(self.source.text)
            self.tokens.append(Token("COMMENT", rest.rstrip(), end - len(rest), end))
            start = end - len(COMMENTS.sub("", rest, count=1))
            if start < end:
                reason = "the text after END is ignored; delete it"
                self.warnings.append(self.source.diagnostic(SceneWarning, Span(start, end), reason, "after-end"))

    def read_statement(self) -> None:
        """Reads a statement into ``fields`` or ``definitions``; a duplicate or one with a wrong index is discarded: its
        path begins with "duplicate" or "unknown".
        """
        role = self.keyword.role
        if role not in KEYED:
            self.begin_value(find_word(role, self.keyword.text).name)
        value = getattr(self, f"read_{role.lower()}")()
        field, *key = self.path
        if key:  # without a field for the value (DEFAULT, discarded values), the dictionary is temporary
            self.fields.get(str(field), {})[key[0]] = value
        else:
            self.fields[str(field)] = value

    def skip_statement(self, error: SceneError) -> bool:
        """Skips to the next line that begins with the keyword of a statement, and removes tokens read beyond; returns
        whether there is one.
        """
        start = max(error.span.start if error.span else 0, self.keyword.start)
        next_statement = STATEMENT_LINE.search(self.source.text, start + 1)
        self.position = next_statement.start() if next_statement else len(self.source.text)
        while self.tokens and self.tokens[-1].end > self.position:
            self.tokens.pop()
        self.skipped, self.token = min(self.skipped, start), START
        return next_statement is not None

    # ---- Tokens

    def with_expected_role(self, token: Token) -> Token:
        """Gives ``token``, the name of a solid, the role USE, and returns it. Raises SceneError if no solid has this
        name, or if no solid is expected here.
        """
        if "USE" not in self.expected or normalise(token.text) not in self.fields["solids"]:
            raise self.unexpected_token(token)
        self.tokens[-1] = self.last = token._replace(role="USE")
        return self.last

    def add_error(self, span: Span, reason: str, code: str) -> None:
        """Adds an error about the text at ``span``, unless the reader has already found more than MAX_ERRORS errors."""
        if len(self.errors) <= MAX_ERRORS:
            self.errors.append(self.source.error(span, reason, code))

    def begin_value(self, *path: str | int, at: Token | None = None) -> None:
        """Sets the path and the span (of ``at``, else of the keyword) of the statement's value. A duplicate is an
        error, and gets a path of its own, so that its parameters do not count as duplicates, too.
        """
        token, self.path = at or self.keyword, path
        if path in self.spans:
            self.store_span_once(token, " ".join(map(str, [self.keyword.text, *([at.text] if at else path[1:])])))
            self.path = "duplicate", token.start
        self.store_span(token.span)

    def store_span(self, span: Span, *path: str | int) -> None:
        """Stores the span of the current statement's value, or of the part with the ``path``."""
        self.spans[self.path + path] = span

    def store_span_once(self, token: Token, what: str, *path: str | int) -> None:
        """Stores the span of a part of the value; an error about ``what`` if it is already set."""
        if first := self.spans.get(self.path + path):
            line, _ = self.source.line_column(first.start)
            self.add_error(token.span, f"{what} stands twice; the first is on line {line}; delete one", "twice")
        else:
            self.store_span(token.span, *path)

    def span_from(self, keyword: Token) -> Span:
        """Returns the span from a keyword to the token before the current token."""
        return Span(keyword.start, self.previous_end)

    # ---- Values

    def read_numbers(self, keyword: Token, follow: frozenset[str], first: Token | None = None) -> Any:
        """Reads the numbers, or TRUE and FALSE, after a keyword, and returns their value. If the numbers are wrong,
        adds an error and returns None.

        ``first`` is the token after the keyword, if this token has already been read. If ``first`` is not a number, no
        further token is read, and the numbers are missing. ``follow`` are the grammar roles that the token after the
        numbers may have. Raises SceneError for a token with another role.
        """
        allowed = words.INDEX if keyword.role == "USE" else find_word(keyword.role, keyword.text).numbers
        self.wanted, self.number_tokens = (keyword.text, allowed), [first] if first and first.role == "NUMBER" else []
        if self.number_tokens or not first:
            expected = follow | ({"NUMBER", "BOOL"} if allowed.flags else {"NUMBER"})
            while self.read_token(expected).role in ("NUMBER", "BOOL"):
                self.number_tokens.append(self.token)
        self.wanted = None
        return self.checked_numbers(keyword, allowed)

    def checked_numbers(self, keyword: Token, allowed: Numbers) -> Any:
        """Returns the value of the numbers read after ``keyword``; None, with an error if they are not ``allowed``, or
        without one if a ``$name`` may be undefined.
        """
        tokens = self.number_tokens
        if self.definitions.undefined and any(self.source.text[token.start] in "${" for token in tokens):
            return None  # the undefined name is reported as an error
        numbers = [allowed.parse(token.text) for token in tokens]
        wrong = [token for token, number in zip(tokens, numbers) if not allowed.allows(number)]
        first, last = (tokens[0], tokens[-1]) if tokens else (keyword, keyword)
        if not allowed.allows_count(len(tokens)):
            noun = ("word" if allowed.flags else "number") + "s" * (len(tokens) != 1)
            reason = f"found {len(tokens)} {noun} after {keyword.text}; expected {allowed.count_in_words()}"
            if comment := COMMENT.match(self.source.text, last.end):
                reason += f"; {quote(comment[1])} is a comment; write the numbers without parentheses and commas"
            self.add_error(Span(first.start, last.end), reason, "count")
        elif wrong:
            text = wrong[0].text
            number = allowed.parse(text)
            reason = f"found {quote(text)} after {keyword.text}; expected {allowed.range_in_words(number)}"
            if allowed.channels and allowed.high == 1 and number in range(2, 256):
                reason += f"; a colour value {text} of 255 is written {number / 255:.3g}"
            self.add_error(wrong[0].span, reason, "range")
        elif allowed.direction and math.hypot(*numbers) < 1 / words.LARGE:
            self.add_error(first.span, f"{keyword.text} has length 0; expected a direction", "range")
        else:
            return allowed.value(numbers)
        return None

    def read_parameters(self, follow: frozenset[str], *owner: str | int) -> dict[str, Any]:
        """Reads parameters; returns a dictionary from their names in the model to their values (None: a wrong value).
        ``follow`` has the roles that may follow a parameter. ``owner`` is the number of the light that has them.
        """
        parameters: dict[str, Any] = {}
        while (keyword := self.token).role in follow and keyword.role not in LIGHTS:
            word = find_word(keyword.role, keyword.text)
            if keyword.role == "DISTRIBUTION":
                self.store_span_once(keyword, "the distribution of a light", *owner, "distribution")
                parameters["distribution"] = word.name
                self.read_token(follow)
            elif keyword.role == "CHOICE":
                self.store_span_once(keyword, keyword.text, word.name)
                choice = self.read_token(frozenset((word.name.upper(),)))
                parameters[word.name] = find_word(choice.role, choice.text).name
                self.read_token(follow)
            elif not word.numbers.count:
                self.read_material(parameters)
            else:
                self.store_span_once(keyword, keyword.text, *owner, word.name)
                if word.name in ("exponent", "facet_exponent", "slope") and keyword.role == "OPTIC":
                    self.store_span_once(keyword, "the roughness", "roughness")
                after = follow | {"MINUS"} if word.name == "vrp" else follow
                parameters[word.name] = self.read_numbers(keyword, after)
                if keyword.role == "VIEW_PARAMETER":
                    self.store_span(self.span_from(keyword), word.name)
                if self.token.role == "MINUS":  # the thesis's example scene has a superfluous dash here
                    self.read_token(follow)
        return parameters

    # ---- One method read_ROLE for each grammar role of a statement's keyword. It returns the value of the statement;
    # afterwards ``token`` is the keyword of the next statement.

    def read_default(self) -> None:
        """Reads a DEFAULT statement, and stores the value of its name in ``definitions``."""
        name = self.read_token(frozenset(("VARIABLE",)))
        value = self.read_token(frozenset(("NUMBER", "WORD", "STRING")))
        self.begin_value("defaults", name.text[1:], at=name)
        self.read_token(STATEMENT_END)
        self.definitions.set_default(name.text[1:], value.text)

    def read_setting(self) -> Any:
        """Reads a statement that consists of one keyword and its numbers or flags (TRUE and FALSE)."""
        return self.read_numbers(self.keyword, STATEMENT_END)

    def read_name(self) -> str:
        """Reads a NAME statement."""
        token = self.read_token(FILE | {"WORD", "TEXTURE_NAME", "NUMBER"})
        self.read_token(STATEMENT_END)
        return token.text

    def read_background(self) -> model.Background:
        """Reads a BACKGROUND statement: a colour, and possibly the file name of an image, or NULL."""
        color, image = self.read_numbers(self.keyword, IMAGE), None
        if self.token.role in FILE:
            image = self.token.text
            self.store_span(self.token.span, "image")
        if self.token.role not in STATEMENT_END:  # an image or NULL
            self.read_token(STATEMENT_END)
        return model.Background(color, image)

    def read_lights(self) -> tuple[model.Light, ...]:
        """Reads a LIGHTS statement. A SKY has an image and no parameters; a CONE without angle has 30 degrees."""
        lights: list[model.Light] = []
        self.read_token(LIGHTS)
        while (token := self.token).role == "LIGHT":
            kind, number, image = find_word("LIGHT", token.text).name, len(lights), None
            self.store_span(token.span, number)
            if kind == "sky":
                image = self.read_token(FILE).text
                self.store_span(self.token.span, number, "image")
            self.read_token(LIGHTS if kind == "sky" else LIGHT)
            parameters = self.read_parameters(LIGHT, number)
            if parameters.get("distribution") == "cone":
                parameters.setdefault("angle", 30.0)
            lights.append(model.Light(kind, image=image, **parameters))
        return tuple(lights)

    def read_method(self) -> model.Method:
        """Reads a METHOD statement."""
        self.read_token(METHOD)
        return model.Method(**self.read_parameters(METHOD))

    def read_view(self) -> model.View:
        """Reads a VIEW statement."""
        self.read_token(VIEW)
        return model.View(**self.read_parameters(VIEW))

    def read_index(self, field: str, follow: frozenset[str]) -> None:
        """Reads the index after SURFACE or TRANSFORM, which sets that value in ``field``; a wrong one begins the path
        with "unknown", so that the value is discarded.
        """
        index = self.read_numbers(self.keyword, follow)
        if index is None and not self.definitions.undefined:
            self.skipped = min(self.skipped, self.keyword.start)  # any index may be the index of this statement
        self.begin_value(*(("unknown", self.keyword.start) if index is None else (field, index)))

    def read_surface(self) -> model.Surface:
        """Reads a SURFACE statement."""
        self.read_index("surfaces", SURFACE)
        return model.Surface(**self.read_parameters(SURFACE))

    def read_material(self, parameters: dict[str, Any]) -> None:
        """Reads ``material KIND [NAME]`` or ``metal NAME``, a conductor, into ``parameters``. Raises SceneError for an
        unknown metal or glass.
        """
        kind = self.token
        if kind.role == "MATERIAL":
            self.store_span_once(kind, "the material", "material")
            kind = self.read_token(frozenset(("MATERIAL_KIND", "CONDUCTOR", "DIELECTRIC")))
            parameters["material"] = find_word(kind.role, kind.text).name
            if self.read_token(SURFACE | {"WORD"} if kind.role in NAMED else SURFACE).role != "WORD":
                return
        else:
            self.read_token(frozenset(("WORD",)))
            parameters.setdefault("material", "conductor")
        name, (field, names) = self.token, NAMED[kind.role]  # a text with "$" is a name without a value
        if normalise(name.text) not in names and not name.text.startswith("$"):
            raise self.source.error(name.span, unknown_name(kind.role, name.text), "unknown-name")
        self.store_span_once(name, f"the {field}", field)
        parameters[field] = names.get(normalise(name.text))
        self.read_token(SURFACE)

    def read_transform(self) -> model.Transform:
        """Reads a TRANSFORM statement: an index and the steps, whose numbers may be in parentheses."""
        self.read_index("transforms", TRANSFORM)
        steps = []
        while (keyword := self.token).role == "STEP":
            if self.read_token(STEP_VALUES).role == "LPAR":
                value = self.read_numbers(keyword, CLOSING)
                self.read_token(TRANSFORM)
            else:
                value = self.read_numbers(keyword, TRANSFORM, self.token)
            kind = find_word("STEP", keyword.text).name
            if kind == "matrix" and value and value[12:] not in ((), (0, 0, 0, 1)):
                reason = f"found the fourth row {' '.join(f'{x:g}' for x in value[12:])}; expected 0 0 0 1, "
                self.add_error(keyword.span, f"{reason}and the translation in the fourth column", "range")
            steps.append(model.Step(kind, value[:12] if isinstance(value, tuple) else (value,)))
        return model.Transform(tuple(steps))

    def read_texture(self) -> model.Pattern:
        """Reads a TEXTURE statement: a name, possibly a kind, and parameters. Without a kind, a predefined texture
        keeps its kind, and a new texture has the empty kind "".
        """
        name, parameters = words.texture_name(self.read_token(frozenset(("TEXTURE_NAME",))).text), dict[str, Any]()
        self.begin_value("patterns", name, at=self.token)
        kind = words.BUILT_IN.get(name, "")
        if (token := self.read_token(TEXTURE | {"KIND"})).role == "KIND":
            # The word brick is a kind, or, before a number, the parameter for the colour of the bricks.
            kind_or_color = find_word("KIND", token.text).name
            if self.read_token(TEXTURE | {"NUMBER"} if kind_or_color == "brick" else TEXTURE).role == "NUMBER":
                self.store_span(token.span, kind_or_color)
                parameters[kind_or_color] = self.read_numbers(token._replace(role="PARAMETER"), TEXTURE, self.token)
            else:
                kind = kind_or_color
        parameters |= self.read_parameters(TEXTURE)
        return model.Pattern(kind, tuple(sorted(parameters.items())))

    def read_solid(self) -> Tree:
        """Reads SOLID, a named CSG tree; an error if the name is a word of the language, or without a tree. After an
        error, the solid is WRONG_SOLID.
        """
        token = self.read_token(frozenset(("WORD",)))
        self.begin_value("solids", normalise(token.text), at=token)
        if normalise(token.text) in words.WORDS_BY_SPELLING:
            self.add_error(token.span, f"{quote(token.text)} is a keyword; expected another name", "name")
        error_count = len(self.errors)
        try:
            nodes = self.read_csg_tree()
        except SceneError:
            self.fields["solids"].setdefault(normalise(token.text), WRONG_SOLID)
            raise
        if not nodes and len(self.errors) == error_count:
            self.add_error(token.span, f"this solid is empty; expected its tree after {token.text}", "incomplete")
        return nodes or WRONG_SOLID

    def read_csg_tree(self) -> Tree:
        """Reads operators and primitives in prefix order, with the nodes of named solids; empty after an error. Raises
        SceneError for an unexpected word or a parenthesis.
        """
        error_count, first_token = len(self.errors), len(self.tokens)
        nodes: list[model.Operator | model.Leaf] = []
        self.read_token(TREE)
        while (token := self.token).role not in STATEMENT_END:
            if token.role == "PRIMITIVE":
                nodes.append(self.read_leaf(len(nodes)))
            elif token.role == "USE":
                nodes += self.read_use(len(nodes))
            else:
                self.store_span(token.span, len(nodes))
                nodes.append(OPERATORS[token.text])
                self.read_token(TREE)
        # Parentheses are comments, so a tree that is written in parentheses was read as an empty tree.
        for token in self.tokens[first_token:] if not nodes else ():
            if token.role == "COMMENT" and token.text[0] == "(" and PRIMITIVE.search(token.text):
                raise self.source.error(token.span, f"this tree is a comment; {PREFIX}", "tree-in-comment")
        if nodes and len(self.errors) == error_count:
            self.check_tree(nodes)
        return tuple(nodes) if len(self.errors) == error_count else ()

    def check_tree(self, nodes: list[model.Operator | model.Leaf]) -> None:
        """Checks that ``nodes`` are one complete CSG tree. If not, adds an error about the first node after the end of
        a complete tree, or about the last operator that lacks an operand.
        """
        ends, count = subtree_ends(nodes), len(nodes)
        if ends[0] == count:
            return
        spans = [self.spans[path] for path in ((*self.path, i) for i in range(count))]
        texts = [" ".join(self.source.text[slice(*span)].split()) for span in spans]
        code, number = "tree", ends[0]
        if number > count:
            number = max(i for i, end in enumerate(ends) if end > count)
            operands = "two operands" if number == count - 1 else "an operand"
            reason = f"this {quote(texts[number])} lacks {operands}; expected a primitive or an operator; {PREFIX}"
        elif [isinstance(node, model.Operator) for node in nodes[:3]] == [False, True, False]:
            code = "infix"
            reason = f"found {quote(texts[1])} between its operands; expected {texts[1]} {texts[0]} {texts[2]}"
        else:
            reason = f"found {quote(texts[number])} after the end of the tree; expected the next statement; {PREFIX}"
        self.add_error(spans[number], reason, code)

    def read_use(self, number: int) -> Tree:
        """Reads the name of a solid and an index; returns the nodes of this solid, for the CSG tree that uses the
        solid. The index is added to the attribute ``within`` of the solid's primitives.

        ``number`` is the position of the first returned node in the CSG tree that uses the solid. Raises SceneError if
        the uses of named solids have more than :data:`MAX_PRIMITIVES` primitives, where a primitive counts once for
        each solid around it.
        """
        keyword, solid = self.token, self.fields["solids"][normalise(self.token.text)]
        index = self.read_numbers(keyword, TREE)
        self.used_primitives += sum(1 + len(node.within) for node in solid if isinstance(node, model.Leaf))
        if self.used_primitives > MAX_PRIMITIVES:
            reason = f"the solids have more than {MAX_PRIMITIVES} primitives; expected fewer uses of {keyword.text}"
            raise self.source.error(keyword.span, reason, "range")
        span = self.span_from(keyword)
        for position in range(len(solid)):
            self.store_span(span, number + position)
        within = () if index is None else (index,)
        return tuple(replace(n, within=n.within + within) if isinstance(n, model.Leaf) else n for n in solid)

    def read_leaf(self, number: int) -> model.Leaf:
        """Reads a primitive: its index (-1 if the index is wrong), the file of a mesh, the radius of a cone or a torus,
        and its textures, two at most. Raises SceneError for a third texture, and for a radius of another primitive.

        ``number`` is the number of nodes (operators and primitives) before the primitive in the CSG tree, in prefix
        order.
        """
        keyword = self.token
        slots: list[model.Texture | None] = []
        shape, file, radius = find_word("PRIMITIVE", keyword.text).name, None, None
        index = self.read_numbers(keyword, FILE if shape == "mesh" else SHAPE)
        if shape == "mesh":
            file = self.token.text
            self.store_span(self.token.span, number, "file")
            self.read_token(SLOTS)
        if (parameter := self.token).role == "SHAPE_PARAMETER":
            if shape not in find_word(parameter.role, parameter.text).kinds:
                reason = f"{parameter.text} has no effect on {keyword.text}; it is for CONE and TORUS"
                raise self.source.error(parameter.span, reason, "unexpected")
            radius = self.read_numbers(parameter, SLOTS)
        while (token := self.token).role not in TREE:
            if len(slots) == 2:
                raise self.source.error(token.span, "this is a third texture; expected two at most", "count")
            self.store_span(token.span, number, "textures", len(slots))
            slots.append(_texture(token))
            self.read_token(SLOTS)
        self.store_span(self.span_from(keyword), number)
        surface, solid, *_ = [*slots, None, None]
        return model.Leaf(shape, -1 if index is None else index, (surface, solid), file=file, radius=radius)

    # ---- Syntax errors

    def unexpected_token(self, token: Token) -> SceneError:
        """Returns the error: the token, what is expected, a suggestion. It is about a ``(`` of numbers that is not
        closed, or at the end of the text about the last token.
        """
        roles, text, span = self.expected, token.text, token.span
        keyword, wanted = self.wanted or ("", words.NO_NUMBERS)
        lacks_numbers = bool(self.wanted) and not wanted.allows_count(len(self.number_tokens))
        if lacks_numbers:
            expected, reason, code = wanted.count_in_words(), f" after {keyword}", "count"
        else:
            roles -= {"NUMBER"} if self.wanted else set()
            expected, reason, code = listing(self.expected_words(roles)), "", "unexpected"
        found, reason = f"found {quote(text)}", f"{reason}; expected {expected}"
        opening = next(t for t in reversed(self.tokens) if t.role == "LPAR") if "RPAR" in roles else None
        if opening and opening.start not in self.closings:
            return self.source.error(opening.span, "this '(' is not closed; expected ')'", "unclosed")
        if not token.role:
            reason = f"the file ends after this; expected {expected}"
            return self.source.error(self.last.span, reason, "unexpected-end")
        if mark := mark_hint(self.source.text, token.start):
            reason, code = mark, "foreign"
        elif "NUMBER" in self.expected and token.role in LIKE_NUMBERS and LIKE_NUMBER.search(text):
            found, code = f"{quote(text)} is not a number", "not-a-number"
            reason = f"; expected {expected}" if lacks_numbers else ""
            reason += f"; {BRACES}" if ARITHMETIC.search(text) else ""
            reason += f"; write {float(percent[1]) / 100:.10g}" if (percent := PERCENTAGE.fullmatch(text)) else ""
        elif token.role == "WORD":
            suggestion = nearest(text, self.fields["solids"] if "USE" in roles else ())
            suggestion = suggestion or suggestion_for(text, roles & {"BOOL"} if lacks_numbers else roles)
            solid = rf"\b(?:{'|'.join(words.spellings_of('SOLID'))})\s+{re.escape(text)}(?!\S)"
            if "USE" in roles and re.compile(solid, re.IGNORECASE).search(self.source.text, token.end):
                suggestion = "; its SOLID stands below, and has to stand above its first use"
            if "USE" in roles and self.path == ("solids", normalise(text)):
                suggestion = "; a solid cannot contain itself"
            if self.keyword.role == "NAME":
                suggestion = '; write a name of several words in quotes: NAME "a red ball"' + suggestion
            found, code, reason = f"unknown word {quote(text)}", "unknown-word", reason + suggestion
        elif not lacks_numbers:
            owner = words.STATEMENT_OF.get(token.role, self.keyword.role)
            if owner != self.keyword.role and roles & STATEMENTS and roles - STATEMENT_END:
                found += f", a word of {words.canonical_spelling(owner)}"
                reason = f"; expected it after {words.canonical_spelling(owner)}, before the next statement"
            reason += (nearest(text, words.ALIASES) if "TEXTURE_NAME" in roles else "") or word_hint(text)
        return self.source.error(span, found + reason, code)

    def expected_words(self, roles: frozenset[str]) -> list[str]:
        """Lists words with these grammar ``roles`` for messages, at most 20 names of solids, and "the next statement"
        or "a statement" for roles of statements.
        """
        inner = [role for role in words.ORDER if role in roles - STATEMENTS]
        names = [name for role in inner for name in words.role_in_words(role)]
        names += list(self.fields["solids"])[:20] if "USE" in roles else ()
        names = [self.source.spellings.get(name, name) for name in names]
        return names + ["the next statement" if inner else "a statement"] * bool(roles & STATEMENTS)


def _texture(token: Token) -> model.Texture | None:
    if token.role == "TEXTURE_NAME":
        return model.Texture(name=words.texture_name(token.text))
    return model.Texture(image=token.text) if token.role != "NULL" else None
