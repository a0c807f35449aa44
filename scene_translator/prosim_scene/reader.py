"""Text -> tokens -> scene model.

The lexer is our own, because of the language's rule for parentheses (an argument directly after SCALE, TRANSLATE and
ROTATE, a remark elsewhere) and because a word is a keyword only where the grammar has a place for that keyword; the
parser is lark's LALR with grammar.lark, which keeps its own stack, so that no input can exhaust Python's.
"""

import math
import re
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from lark import Lark, Token, UnexpectedToken
from lark.lexer import Lexer

from . import model
from .errors import Place, SceneError, Source, listing, nearest, quote
from .words import FALSE, METALS, TERMINALS, WORDS, fold, meaning

#: Larger files are refused: a scene of 10,000 primitives has about 2 MiB.
SIZE_LIMIT = 16 * 2**20

PIECE = re.compile(r'(?P<space>\s+)|(?P<remark>\#[^\n]*)|(?P<open>\()|(?P<close>\))|(?P<string>"[^"\n]*"?)'
                   r'|(?P<equals>[:=])|(?P<operator>[*+-](?![\d.]|inf|nan))|(?P<word>[^\s()#":=]+)', re.IGNORECASE)
PARENTHESIS = re.compile(r"[()]")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)
OPERATORS = {"+": "PLUS", "-": "MINUS", "*": "TIMES"}


class _Lexer(Lexer):
    """Tokens with keywords decided by what the parser accepts at that place. Keeps all that the formatter needs."""

    __future_interface__ = True

    def __init__(self, _):
        pass

    def lex(self, lexer_state, parser_state):
        source = lexer_state.text.source
        pieces = lexer_state.text.pieces  # remarks and tokens in order, for the formatter
        states = parser_state.parse_conf.parse_table.states
        text = source.text
        end = None  # the END token
        open_argument = None
        previous = None
        position = 0
        while position < len(text):
            match = PIECE.match(text, position)
            kind, start, position = match.lastgroup, position, match.end()
            if kind == "space":
                continue
            if kind == "open" and "LPAR" in states[parser_state.position]:  # directly after SCALE, ROTATE or TRANSLATE
                token = open_argument = Token("LPAR", "(", start, end_pos=position)
            elif kind == "open" or kind == "remark":
                if kind == "open":
                    position = _end_of_remark(source, start)
                pieces.append(Token("REMARK", text[start:position], start, end_pos=position))
                continue
            elif kind == "close":
                if not open_argument:
                    raise source.error(Place(start, position), "found ')' without its '('")
                token, open_argument = Token("RPAR", ")", start, end_pos=position), None
            elif kind == "equals":
                if previous is None or previous.type not in WORDS:
                    raise source.error(Place(start, position), f"found {match[0]!r}, which may only follow a keyword")
                continue
            elif kind == "string":
                if len(match[0]) < 2 or match[0][-1] != '"':
                    raise source.error(Place(start, position), "this quote is not closed on its line")
                token = Token("STRING", match[0][1:-1], start, end_pos=position)
            elif kind == "operator":
                token = Token(OPERATORS[match[0]], match[0], start, end_pos=position)
            else:
                accepted = states[parser_state.position]
                token = Token(_word_type(match[0], accepted), match[0], start, end_pos=position)
                if token.type == "END" and "END" in accepted:
                    end = token
            pieces.append(token)
            yield token
            previous = token
            if end:
                break
        if open_argument:
            raise source.error(Place(open_argument.start_pos, open_argument.end_pos), "this '(' is not closed")
        if end:
            rest = _after_end(source, position, pieces)
            if rest:
                warnings.warn(source.warning(rest, "what follows END is ignored"), stacklevel=2)


def _end_of_remark(source, start):
    depth = 0
    for match in PARENTHESIS.finditer(source.text, start):
        depth += 1 if match[0] == "(" else -1
        if depth == 0:
            return match.end()
    raise source.error(Place(start, start + 1), "this remark is not closed; expected ')'")


def _after_end(source, position, pieces):
    """Keeps the remarks after END; returns the place of anything else, which is kept as one remark-like piece."""
    text = source.text
    while position < len(text):
        match = PIECE.match(text, position)
        if match.lastgroup == "open":
            try:
                stop = _end_of_remark(source, position)
            except SceneError:
                stop = None
        else:
            stop = match.end() if match.lastgroup in ("space", "remark") else None
        if stop is None:
            pieces.append(Token("REST", text[position:], position, end_pos=len(text)))
            return Place(position, match.end())
        if match.lastgroup != "space":
            pieces.append(Token("REMARK", text[position:stop], position, end_pos=stop))
        position = stop
    return None


def _word_type(word, accepted):
    """The terminal of a word: a number, the keyword that fits here, a name, or else whatever explains it best."""
    if NUMBER.fullmatch(word):
        return "NUMBER"
    folded = fold(word)
    keyword = TERMINALS.get(folded)
    if keyword in accepted:
        return keyword
    if folded.startswith("t-") and "TEXTURE_NAME" in accepted:
        return "TEXTURE_NAME"
    if "FILE" in accepted and "." in word and any(c.isalpha() for c in word):
        return "FILE"
    if "WORD" in accepted:
        return "WORD"
    return keyword or "WORD"


@dataclass
class _Text:
    """What lark hands to the lexer as its text."""

    source: Source
    pieces: list


@cache
def _parser():
    grammar = Path(__file__).with_name("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", lexer=_Lexer)


def tokens_and_tree(source):
    """All pieces of the text in order (tokens and remarks), and lark's tree; raises SceneError."""
    pieces = []
    try:
        return pieces, _parser().parse(_Text(source, pieces))
    except UnexpectedToken as error:
        raise _syntax_error(source, error, pieces) from None


STATEMENTS = ("NAME", "SAVE_RGB", "MAX_LEVEL", "NSAMPLES", "DO_SHADOW", "AIR_INDEX", "AMBIENT", "LIGHTS", "BACKGROUND",
              "VIEW", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE", "END")


def _syntax_error(source, error, pieces):
    # lark's own ``expected`` has whatever could follow in some other place of the same rule.
    token, expected = error.token, set(error.accepts)
    inner = sorted(expected - set(STATEMENTS), key=list(WORDS).index if expected <= set(WORDS) else None)
    names = [meaning(t) for t in inner] + (["a statement" if not inner else "the next statement"]
                                           if expected & set(STATEMENTS) else [])
    if expected == {"END"}:
        names = ["END"]
    if token.type == "$END":
        tokens = [p for p in pieces if p.type != "REMARK"]
        place = Place(tokens[-1].start_pos, tokens[-1].end_pos) if tokens else Place(0, 0)
        if "END" in expected:
            return source.error(place, "the file ends here and END is missing; expected END as the last statement")
        return source.error(place, f"the file ends after this; expected {listing(names)}")
    place = Place(token.start_pos, token.end_pos)
    if token.type == "WORD" and fold(token.value.lstrip("+-")) in ("nan", "inf", "infinity") and "NUMBER" in expected:
        return source.error(place, f"found {quote(token)}; expected a finite number")
    if token.type == "WORD" and "NUMBER" in expected and token.value[0] in "0123456789.+-":
        return source.error(place, f"found {quote(token)}, which is not a number")
    reason = "found " + quote(token)
    if token.type == "WORD":
        known = [w for t in expected if t in WORDS for w in WORDS[t]]
        reason = f"unknown word {quote(token)}; expected {listing(names)}"
        every = [w for ws in WORDS.values() for w in ws]
        return source.error(place, reason + (nearest(token, known, 0.75) or nearest(token, every)))
    if token.type in WORDS and token.type not in STATEMENTS and "NUMBER" not in expected:
        reason += f", which has no place here; expected {listing(names)}"
    else:
        reason += f"; expected {listing(names)}"
    return source.error(place, reason)


# ---- Tree -> model ---------------------------------------------------------------------------------------------------

#: How many numbers a word takes, and what they are.
COUNTS = {
    "MAX_LEVEL": (1, "a level"), "NSAMPLES": (1, "the number N"), "AIR_INDEX": (1, "the index of refraction"),
    "AMBIENT": (3, "r g b"), "BACKGROUND": (3, "r g b"), "POSITION": (3, "x y z"), "INTENSITY": (3, "r g b"),
    "RADIUS": (1, "the radius"), "DIRECTION": (3, "x y z"), "ANGLE": (1, "degrees"), "EXPONENT": (1, "n"),
    "RESOLUTION": (2, "width height"), "WINDOW": (4, "umin vmin umax vmax"), "OBS": (3, "x y z"), "VPN": (3, "x y z"),
    "VRP": (3, "x y z"), "VUP": (3, "x y z"), "SCALE": (3, "x y z"), "TRANSLATE": (3, "x y z"),
    "ROTATE_X": (1, "degrees"), "ROTATE_Y": (1, "degrees"), "ROTATE_Z": (1, "degrees"), "PHONG_N": (1, "n"),
    "RUG": (1, "a Phong exponent"), "SLOPE": (1, "the RMS slope"), "SURFACE": (1, "its index"),
    "TRANSFORM": (1, "its index"), "CUBE": (1, "its index"), "SPHERE": (1, "its index"), "CYLINDER": (1, "its index"),
    "CONE": (1, "its index"), "BRICK_WIDTH": (1, "a length"), "BRICK_HEIGHT": (1, "a length"),
    "MORTAR_WIDTH": (1, "a length"), "STAGGER": (1, "a fraction"), "FREQUENCY": (1, "pairs a unit"),
    "DUTY": (1, "a fraction"), "AXIS": (3, "x y z"), "OCTAVES": (1, "a number"), "GAIN": (1, "a factor"),
    "LACUNARITY": (1, "a factor"), "SEED": (1, "a number"),
}
#: Words that take one value a channel, or one for all three.
PER_CHANNEL = {"KA", "KD", "KS", "N_REFR", "K_ABS", "BRICK", "MORTAR", "COLOR0", "COLOR1"}

#: Kinds of patterns, and the terminals of their parameters.
PATTERNS = {
    "brick": ("BRICK", "MORTAR", "BRICK_WIDTH", "BRICK_HEIGHT", "MORTAR_WIDTH", "STAGGER"),
    "stripes": ("COLOR0", "COLOR1", "FREQUENCY", "DUTY", "AXIS"),
    "fractal": ("COLOR0", "COLOR1", "SCALE", "OCTAVES", "GAIN", "LACUNARITY", "SEED"),
}
#: The patterns that need no TEXTURE statement, and their other names.
BUILT_IN = {"t-tijolo": "brick", "t-listra": "stripes", "t-fractal": "fractal"}
ALIASES = {"t-brick": "t-tijolo", "t-stripes": "t-listra", "t-listras": "t-listra"}


class _Builder:
    def __init__(self, source):
        self.source = source

    # -- values

    def error(self, where, reason):
        return self.source.error(_place(where), reason)

    def number(self, token):
        value = float(token)
        if not math.isfinite(value):
            raise self.error(token, f"found {quote(token)}; expected a finite number")
        return value

    def numbers(self, children, texture=False):
        """The numbers after a keyword, counted; one number where the keyword takes one."""
        keyword = children[0]
        values = [c for c in children[1:] if c.type == "NUMBER"]
        if keyword.type in PER_CHANNEL:
            if len(values) not in (1, 3):
                raise self.count_error(keyword, values, "3 numbers (r g b), or 1 for all channels")
            values = [self.number(v) for v in values]
            return tuple(values * (3 // len(values)))
        count, what = (1, "a frequency") if texture and keyword.type == "SCALE" else COUNTS[keyword.type]
        if len(values) != count:
            raise self.count_error(keyword, values, f"{count} number{'s' * (count > 1)} ({what})")
        values = tuple(self.number(v) for v in values)
        return values[0] if count == 1 else values

    def count_error(self, keyword, values, expected):
        where = Place(values[0].start_pos, values[-1].end_pos) if values else _place(keyword)
        return self.error(where, f"found {len(values)} number{'s' * (len(values) != 1)} after {keyword}; expected {expected}")

    def whole(self, children, least, most=2**31 - 1):
        value = self.numbers(children)
        if value != int(value) or not least <= value <= most:
            raise self.error(children[1], f"found {quote(children[1])} after {children[0]}; "
                                          f"expected a whole number, {least} or more" + (f", {most} at most" if most < 2**31 - 1 else ""))
        return int(value)

    def ranged(self, children, low=0.0, high=math.inf, open_low=False):
        """Numbers that lie in [low, high] (or above low)."""
        value = self.numbers(children)
        tokens = [c for c in children[1:] if c.type == "NUMBER"]
        for token in tokens:
            x = float(token)
            if x < low or x > high or (open_low and x == low):
                bounds = (f"above {low:g}" if open_low else f"{low:g} or more") + (
                    f", {high:g} at most" if high < math.inf else "")
                raise self.error(token, f"found {quote(token)} after {children[0]}; expected {bounds}")
        return value

    def once(self, seen, key, token, what):
        """Records that ``what`` was given; an error where it was given before."""
        if key in seen:
            line = self.source.line(seen[key])
            raise self.error(token, f"{what} is given twice; the first is on line {line}")
        seen[key] = _place(token)

    def warn(self, where, reason):
        warnings.warn(self.source.warning(_place(where), reason), stacklevel=2)

    # -- statements

    def scene(self, tree):
        self.fields, self.seen = {}, {}
        self.surfaces, self.transforms, self.patterns = {}, {}, {}
        for statement in tree.children:
            if not isinstance(statement, Token):  # END
                getattr(self, statement.data)(statement.children)
        name = self.fields.pop("name", None) or Path(self.source.filename).stem or "scene"
        scene = model.Scene(name=name, **self.fields, surfaces=self.surfaces, transforms=self.transforms,
                            patterns=self.patterns, places=self.seen, source=self.source)
        self.check(scene)
        return scene

    def setting(self, children):
        keyword = children[0]
        self.once(self.seen, keyword.type, keyword, str(keyword))
        if keyword.type in ("SAVE_RGB", "DO_SHADOW"):
            count = 3 if keyword.type == "SAVE_RGB" else 1
            values = children[1:]
            for v in values:
                if v.type == "NUMBER" and v not in ("0", "1"):
                    raise self.error(v, f"found {quote(v)} after {keyword}; expected TRUE or FALSE")
            if len(values) != count:
                raise self.error(Place(keyword.start_pos, children[-1].end_pos),
                                 f"found {len(values)} words after {keyword}; expected {count}, TRUE or FALSE")
            values = tuple(fold(v) not in FALSE for v in values)
            if count == 3 and not any(values):
                raise self.error(keyword, f"{keyword} leaves out all channels; expected TRUE for one at least")
            field, value = ("channels", values) if count == 3 else ("shadows", values[0])
        else:
            for token in children[1:]:
                if token.type == "BOOL":
                    raise self.error(token, f"found {quote(token)} after {keyword}; expected a number")
            field, value = {
                "MAX_LEVEL": lambda: ("max_level", self.whole(children, 0, 24)),
                "NSAMPLES": lambda: ("samples", self.whole(children, 1, 1000)),
                "AIR_INDEX": lambda: ("air_index", self.ranged(children, 0, open_low=True)),
                "AMBIENT": lambda: ("ambient", self.ranged(children)),
            }[keyword.type]()
        self.fields[field] = value

    def name(self, children):
        keyword, value = children
        self.once(self.seen, "NAME", keyword, "NAME")
        if not value.strip() or value in (".", "..") or any(c in '/\\:*?<>|"' or not c.isprintable() for c in value):
            raise self.error(value, f"found {quote(value)}; expected the base name of a file, without a folder")
        if len(value) > 200:
            raise self.error(value, f"found a name of {len(value)} characters; expected 200 at most")
        self.fields["name"] = str(value)

    def background(self, children):
        keyword = children[0]
        self.once(self.seen, "BACKGROUND", keyword, "BACKGROUND")
        image = children[-1] if children[-1].type in ("FILE", "STRING") else None
        self.fields["background"] = model.Background(self.ranged(children), image and str(image),
                                                     at=_place(image if image is not None else keyword))

    def lights(self, children):
        self.once(self.seen, "LIGHTS", children[0], "LIGHTS")
        self.fields["lights"] = tuple(self.light(c.children) for c in children[1:])

    def light(self, children):
        keyword, seen, values = children[0], {}, {}
        for item in children[1:]:
            parts = item.children
            word = parts[0]
            if word.type in ("UNIFORM", "CONE", "SPOT"):
                self.once(seen, "DISTRIBUTION", word, "the distribution of a light")
                values["distribution"] = word.type.lower()
                continue
            self.once(seen, word.type, word, str(word))
            if word.type == "INTENSITY":
                value = self.ranged(parts)
            elif word.type == "RADIUS":
                value = self.ranged(parts, open_low=True)
            elif word.type == "ANGLE":
                value = self.ranged(parts, 0, 180, open_low=True)
            elif word.type == "EXPONENT":
                value = self.ranged(parts)
            else:
                value = self.numbers(parts)
                if word.type == "DIRECTION" and not any(value):
                    raise self.error(parts[1], "the direction of a light has length 0")
            values[word.type.lower()] = value
        if "POSITION" not in seen:
            raise self.error(keyword, f"this {keyword} light has no position; expected position x y z")
        distribution = values.get("distribution", "uniform")
        for word, use in (("DIRECTION", ("cone", "spot")), ("ANGLE", ("cone", "spot")), ("EXPONENT", ("spot",))):
            if word in seen and distribution not in use:
                self.warn(seen[word], f"has no effect on a {distribution.upper()} light")
        if distribution == "cone":
            values.setdefault("angle", 30.0)
        return model.Light(keyword.type.lower(), **values, at=_place(keyword))

    def view(self, children):
        keyword, seen, values = children[0], {}, {}
        self.once(self.seen, "VIEW", keyword, "VIEW")
        names = {"RESOLUTION": "resolution", "WINDOW": "window", "OBS": "eye", "VPN": "vpn", "VRP": "vrp", "VUP": "vup"}
        for item in children[1:]:
            parts = item.children
            word = parts[0]
            self.once(seen, word.type, word, str(word))
            value = self.numbers(parts)
            if word.type == "RESOLUTION":
                for token, v in zip(parts[1:], value):
                    if v != int(v) or not 1 <= v <= 65536:
                        raise self.error(token, f"found {quote(token)} after {word}; "
                                                "expected a whole number of pixels, 1 to 65536")
                value = tuple(map(int, value))
            values[names[word.type]] = value
            self.seen[word.type] = Place(word.start_pos, parts[-1].end_pos)
        self.fields["view"] = model.View(**values, at=_place(keyword))

    def csg(self, children):
        keyword = children[0]
        self.once(self.seen, "CSG_TREE", keyword, "CSG-TREE")
        nodes, missing = [], []  # missing: the operators that still lack operands, and how many
        for item in children[1:]:
            token = item.children[0]
            if nodes and not missing:
                raise self.error(token, f"found {quote(token)} after the tree is complete; "
                                        f"expected the next statement, or one more operator before the operands")
            if item.data == "operator":
                nodes.append(model.Operator(str(token), at=_place(token)))
                missing.append([token, 2])
                continue
            nodes.append(self.leaf(item.children))
            while missing:
                missing[-1][1] -= 1
                if missing[-1][1]:
                    break
                missing.pop()
        if missing:
            token, count = missing[-1]
            raise self.error(token, f"this {quote(token)} lacks {'an operand' if count == 1 else 'two operands'}; "
                                    "expected a primitive or an operator")
        self.fields["csg"] = tuple(nodes)

    def leaf(self, children):
        shape = children[0]
        slots = [c for c in children[1:] if c.type != "NUMBER"]
        if len(slots) > 2:
            raise self.error(slots[2], f"found {quote(slots[2])}, a third texture; expected two at most")
        index = self.index(children)
        textures = [self.texture_slot(s) for s in slots] + [None] * (2 - len(slots))
        return model.Leaf(shape.type.lower(), index, tuple(textures), at=Place(shape.start_pos, children[-1].end_pos))

    def texture_slot(self, token):
        if token.type == "NULL":
            return None
        if token.type == "TEXTURE_NAME":
            return model.Texture(name=_texture_name(token), at=_place(token))
        return model.Texture(image=str(token), at=_place(token))

    def index(self, children):
        numbers = [c for c in children[:2] if c.type == "NUMBER"]
        if numbers and len(numbers[0]) > 9:
            raise self.error(numbers[0], f"found {quote(numbers[0])}; expected an index of 9 digits at most")
        return self.whole(children, 0)

    def surface(self, children):
        keyword = children[0]
        index = self.index([c for c in children if isinstance(c, Token)])
        self.once(self.seen, ("SURFACE", index), keyword, f"SURFACE {index}")
        seen, values = {}, {}
        for item in children[1:]:
            if isinstance(item, Token):
                continue
            parts = item.children
            word = parts[0]
            if word.type == "MATERIAL":
                self.once(seen, "MATERIAL", word, "the material")
                values["material"] = parts[1].type.lower()
                if len(parts) > 2:
                    self.once(seen, "METAL", parts[2], "the metal")
                    values["metal"] = self.metal(parts[2], ("KA", "N_REFR", "K_ABS", "RUG", "PHONG_N", "SLOPE"))
            elif word.type == "METAL":
                self.once(seen, "METAL", word, "the metal")
                values["metal"] = self.metal(parts[1])
            else:
                self.once(seen, word.type, word, str(word))
                if word.type in ("PHONG_N", "RUG", "SLOPE"):
                    self.once(seen, "ROUGHNESS", word, "the roughness")
                field, arguments = {
                    "KA": ("ka", {}), "KD": ("kd", {"high": 1.0}), "KS": ("ks", {"high": 1.0}),
                    "N_REFR": ("eta", {"open_low": True}), "K_ABS": ("k", {}), "PHONG_N": ("exponent", {}),
                    "RUG": ("exponent", {}), "SLOPE": ("slope", {}),
                }[word.type]
                values[field] = self.ranged(parts, **arguments)
        if "metal" in values:
            values.setdefault("material", "conductor")
        surface = model.Surface(index, **values, at=_place(keyword))
        self.check_surface(surface, seen)
        self.surfaces[index] = surface

    def metal(self, token, or_words=()):
        table = METALS.get(fold(token))
        if table is None:
            words = [*METALS, *(w for t in or_words for w in WORDS[t])]
            raise self.error(token, f"unknown metal {quote(token)}; expected one of "
                                    f"Ag, Al, Au, Cr, Cu, Hg, Ni, W, ... or its name{nearest(token, words)}")
        return table

    def check_surface(self, surface, seen):
        """What a material needs, and what has no meaning for it."""
        where = surface.at
        if surface.material == "conductor":
            if surface.metal and (surface.eta or surface.k):
                raise self.error(seen["METAL"], "a metal's name and n-refr or k-abs are given; expected one of the two")
            if not surface.metal and not (surface.eta and surface.k):
                raise self.error(where, "a condutor lacks its optics; expected n-refr and k-abs, or a metal's name")
        elif surface.material in ("dielectric", "composite") and not surface.eta:
            raise self.error(where, f"a {WORDS[surface.material.upper()][0]} lacks its index; expected n-refr")
        elif surface.material == "composite" and surface.ks and max(map(sum, zip(surface.kd or (0.5,) * 3, surface.ks))) > 1 + 1e-6:
            raise self.error(where, "kd + ks is above 1 in a composto; expected s + d = 1 at most")
        uses = {
            "conductor": "MATERIAL METAL N_REFR K_ABS KA PHONG_N RUG SLOPE ROUGHNESS",
            "dielectric": "MATERIAL N_REFR KA PHONG_N RUG SLOPE ROUGHNESS",
            "lambertian": "MATERIAL KD KA",
            "composite": "MATERIAL N_REFR KD KS KA PHONG_N RUG SLOPE ROUGHNESS",
            None: "KA KD KS PHONG_N RUG SLOPE ROUGHNESS",
        }[surface.material].split()
        for word, place in seen.items():
            if word not in uses:
                kind = WORDS[surface.material.upper()][0] if surface.material else "surface without a material"
                self.warn(place, f"has no effect on a {kind}")

    def transform(self, children):
        keyword = children[0]
        index = self.index([c for c in children if isinstance(c, Token)])
        self.once(self.seen, ("TRANSFORM", index), keyword, f"TRANSFORM {index}")
        steps = []
        for item in children[1:]:
            if isinstance(item, Token):
                continue
            parts = [p for p in item.children if p.type not in ("LPAR", "RPAR")]
            values = self.numbers(parts)
            values = values if isinstance(values, tuple) else (values,)
            if parts[0].type == "SCALE" and 0 in values:
                zero = parts[1 + values.index(0)]
                raise self.error(zero, f"found {quote(zero)}; this scale is singular, expected factors other than 0")
            kind = parts[0].type.lower().replace("_", "-")
            steps.append(model.Step(kind, values, at=Place(parts[0].start_pos, parts[-1].end_pos)))
        self.transforms[index] = model.Transform(index, tuple(steps), at=_place(keyword))

    def texture(self, children):
        keyword, token = children[:2]
        name = _texture_name(token)
        self.once(self.seen, ("TEXTURE", name), keyword, f"TEXTURE {name}")
        kinds = [c.children[0] for c in children[2:] if c.data == "texture_kind"]
        kind = kinds[0].type.lower() if kinds else BUILT_IN.get(name)
        if kind is None:
            raise self.error(token, f"the texture {quote(token)} has no kind; expected brick, stripes or fractal after its "
                                    f"name{nearest(name, BUILT_IN)}")
        seen, parameters = {}, []
        for item in children[2:]:
            if item.data != "texture_item":
                continue
            parts = item.children
            word = parts[0]
            self.once(seen, word.type, word, str(word))
            if word.type not in PATTERNS[kind]:
                words = [WORDS[t][0] for t in PATTERNS[kind]]
                raise self.error(word, f"found {quote(word)} in a texture of kind {kind}; expected {listing(words)}")
            parameters.append((word.type.lower(), self.texture_value(parts)))
        self.patterns[name] = model.Pattern(name, kind, tuple(sorted(parameters)), at=_place(keyword))

    def texture_value(self, parts):
        word = parts[0].type
        if word in PER_CHANNEL or word in ("MORTAR_WIDTH", "GAIN"):
            return self.ranged(parts)
        if word in ("DUTY", "STAGGER"):
            return self.ranged(parts, 0, 1)
        if word == "OCTAVES":
            return self.whole(parts, 1, 16)
        if word == "SEED":
            return self.whole(parts, 0)
        value = self.numbers(parts, texture=True)
        if word == "AXIS":
            if not any(value):
                raise self.error(parts[1], "the axis of a texture has length 0")
        elif value <= 0:
            raise self.error(parts[1], f"found {quote(parts[1])} after {parts[0]}; expected a number above 0")
        return value

    # -- the whole

    def check(self, scene):
        """Indices and texture names that lead nowhere; what is given and never used."""
        used = set()
        for leaf in scene.csg:
            if not isinstance(leaf, model.Leaf):
                continue
            used.add(leaf.index)
            for table, keyword in ((scene.surfaces, "SURFACE"), (scene.transforms, "TRANSFORM")):
                if leaf.index not in table:
                    given = sorted(table)
                    known = f"; there are {listing(given[:20], 'and')}" if given else ""
                    raise self.error(leaf.at, f"{leaf.shape.upper()} {leaf.index} has no {keyword} {leaf.index}; "
                                              f"expected a statement {keyword} {leaf.index}{known}")
            for texture in leaf.textures:
                if texture and texture.name and texture.name not in BUILT_IN and texture.name not in scene.patterns:
                    names = [*BUILT_IN, *ALIASES, *scene.patterns]
                    raise self.error(texture.at, f"unknown texture {quote(texture.name)}; expected "
                                                 f"{listing([*BUILT_IN, *scene.patterns][:20])}, an image file or NULL"
                                                 f"{nearest(texture.name, names)}")
            if leaf.textures[1] and leaf.textures[1].image:
                raise self.error(leaf.textures[1].at, "an image stands in the second texture slot, which is solid; "
                                                      "expected it in the first")
        for table in (scene.surfaces, scene.transforms):
            for index, statement in table.items():
                if index not in used:
                    self.warn(statement.at, "no primitive has this index")
        if not scene.csg:
            self.warn(self.seen.get("CSG_TREE", Place(0, 0)), "the scene has no CSG-TREE: nothing but the background is seen")
        if not scene.lights:
            self.warn(self.seen.get("LIGHTS", Place(0, 0)), "the scene has no lights")


def _place(where):
    return where if isinstance(where, Place) else Place(where.start_pos, where.end_pos)


def _texture_name(token):
    name = fold(token)
    return ALIASES.get(name, name)


# ---- Entry points ----------------------------------------------------------------------------------------------------


def parse(text, filename="<string>"):
    """The scene that ``text`` describes, as a :class:`~prosim_scene.model.Scene`.

    Raises :class:`SceneError` for any wrong input; what is only doubtful is a :class:`SceneWarning`.
    """
    source = Source(_check_size(text, filename), filename)
    _, tree = tokens_and_tree(source)
    return _Builder(source).scene(tree)


def read(path):
    """The text of a scene file: UTF-8, or Latin-1 where it is not valid UTF-8."""
    path = Path(path)
    try:
        if path.stat().st_size > SIZE_LIMIT:
            raise _too_large(path)
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", str(path)) from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _check_size(text, filename):
    if len(text) > SIZE_LIMIT:
        raise _too_large(filename)
    return text


def _too_large(filename):
    return SceneError(f"{filename}: the file is larger than {SIZE_LIMIT >> 20} MiB, the most that a scene may have",
                      str(filename))
