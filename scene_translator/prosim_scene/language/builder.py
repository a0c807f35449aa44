"""lark's tree -> model: each statement's values by the table of words, and their places."""

import math
from collections.abc import Iterable
from typing import Any

from lark import Token, Tree

from .. import model
from . import checks, parentheses
from .document import Path, Places
from .hints import nearest, unknown_name
from .lexer import place
from .messages import CLIP, Place, SceneError, Source, listing, quote
from .names import ALIASES, BUILT_IN, GLASSES, METALS
from .parentheses import EXPLAINED
from .values import read_value, span
from .words import PIXELS, Word, fold, of_role, row

Node = Tree[Token]


class Builder:
    """Statements on their way from the tree to the model."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.places: dict[Path, Place] = {}
        self.fields: dict[str, Any] = {"surfaces": {}, "transforms": {}, "patterns": {}}

    def statements(self, tree: Node) -> None:
        """Puts the values of a tree's statements into ``fields``, by the names of a Scene's; raises SceneError."""
        for statement in _trees(tree.children):
            getattr(self, statement.data)(self.fields, statement.children)

    def error(self, where: Token | Place, reason: str) -> SceneError:
        """The error to raise about a token or a place."""
        return self.source.error(place(where) if isinstance(where, Token) else where, reason)

    def once(self, token: Token, what: str, *path: str | int) -> None:
        """Records that a value was given; an error where it was given before."""
        if path in self.places:
            raise self.error(
                token, f"{what} is given twice; the first is on line {self.source.line(self.places[path])}"
            )
        self.places[path] = place(token)

    def index(self, children: Iterable[Token | Node]) -> int:
        """The index after SURFACE, TRANSFORM or a primitive."""
        tokens = [c for c in children if isinstance(c, Token)]
        for token in tokens[1:2]:
            if token.type == "NUMBER" and len(token) > 9:
                raise self.error(token, f"found {quote(token)}; expected an index of 9 digits at most")
        return int(read_value(self.source, tokens))

    def parameter(self, item: Node, *owner: str | int) -> tuple[Word, Any]:
        """The row and the value of a keyword with its numbers, which may stand once in its ``owner``."""
        tokens = _tokens(item)
        word = row(tokens[0])
        self.once(tokens[0], str(tokens[0]), *owner, word.name)
        return word, read_value(self.source, tokens)

    def default(self, _: dict[str, Any], children: list[Token]) -> None:
        """DEFAULT; the name's value has been put in its places by the lexer."""
        name = children[1]
        self.once(name, f"DEFAULT {name}", "defaults", str(name[1:]))

    def setting(self, fields: dict[str, Any], children: list[Token]) -> None:
        """A statement of one keyword and its values."""
        keyword = children[0]
        word = row(keyword)
        self.once(keyword, str(keyword), word.name)
        fields[word.name] = read_value(self.source, children)
        if word.name == "channels" and not any(fields[word.name]):
            raise self.error(keyword, f"{keyword} leaves out all channels; expected TRUE for one at least")

    def name(self, fields: dict[str, Any], children: list[Token]) -> None:
        """NAME."""
        keyword, value = children
        self.once(keyword, "NAME", "name")
        if not value.strip() or value in (".", "..") or any(c in '/\\:*?<>|"' or not c.isprintable() for c in value):
            raise self.error(value, f"found {quote(value)}; expected the base name of a file, without a folder")
        if len(value) > 200:
            raise self.error(value, f"found a name of {len(value)} characters; expected 200 at most")
        fields["name"] = str(value)

    def background(self, fields: dict[str, Any], children: list[Token]) -> None:
        """BACKGROUND."""
        self.once(children[0], "BACKGROUND", "background")
        image = None
        if children[-1].type in ("FILE", "STRING"):
            self.places["background", "image"] = place(children[-1])
            image = str(children[-1])
            if len(children) == 2:
                raise self.error(
                    children[-1], f"found {quote(image)} after BACKGROUND; expected 3 numbers (r g b) before the image"
                )
        fields["background"] = model.Background(read_value(self.source, children), image)

    def lights(self, fields: dict[str, Any], children: list[Token | Node]) -> None:
        """LIGHTS."""
        keyword = children[0]
        assert isinstance(keyword, Token)
        self.once(keyword, "LIGHTS", "lights")
        fields["lights"] = tuple(self.light(i, light.children) for i, light in enumerate(_trees(children)))

    def light(self, number: int, children: list[Any]) -> model.Light:
        """One light."""
        keyword, *items = children
        self.places["lights", number] = place(keyword)
        values: dict[str, Any] = {}
        for item in items:
            if isinstance(item, Token):
                self.once(item, "the distribution of a light", "lights", number, "distribution")
                values["distribution"] = row(item).name
            else:
                word, values[word.name] = self.parameter(item, "lights", number)
        if "position" not in values:
            raise self.error(
                keyword,
                f"this {keyword} light has no position; expected where it is after {keyword}, such as position 0 20 10",
            )
        if values.get("distribution") == "cone":
            values.setdefault("angle", 30.0)
        light = model.Light(row(keyword).name, **values)
        checks.light(Places(self.source, self.places), number, light)
        return light

    def view(self, fields: dict[str, Any], children: list[Any]) -> None:
        """VIEW."""
        self.once(children[0], "VIEW", "view")
        values = {}
        for item in children[1:]:
            word, values[word.name] = self.parameter(item, "view")
            self.places["view", word.name] = span(_tokens(item))
        if math.prod(values.get("resolution", ())) > PIXELS:
            raise self.error(self.places["view", "resolution"], f"these are too many pixels; expected {PIXELS} at most")
        fields["view"] = model.View(**values)

    def csg(self, fields: dict[str, Any], children: list[Any]) -> None:
        """CSG-TREE."""
        self.once(children[0], "CSG-TREE", "csg")
        if infix := parentheses.infix(self.source, children[1:]):
            raise self.error(
                children[2].children[0],
                f"found {quote(children[2].children[0])} between its operands; expected it before them: "
                f"{infix if len(infix) <= CLIP else EXPLAINED}",
            )
        nodes: list[model.Operator | model.Leaf] = []
        missing: list[tuple[Token, int]] = []  # the operators that still lack operands, and how many
        for number, item in enumerate(children[1:]):
            token = item.children[0]
            if nodes and not missing:
                raise self.error(
                    token,
                    f"found {quote(token)} after the tree is complete; expected the next statement, or "
                    f"one more operator before the operands: {EXPLAINED}",
                )
            self.places["csg", number] = span(_tokens(item))
            if item.data == "operator":
                nodes.append(model.Operator(str(token)))
                missing.append((token, 2))
                continue
            nodes.append(self.leaf(number, item.children))
            while missing:
                token, count = missing.pop()
                if count > 1:
                    missing.append((token, count - 1))
                    break
        if missing:
            token, count = missing[-1]
            raise self.error(
                token,
                f"this {quote(token)} lacks {'an operand' if count == 1 else 'two operands'}; "
                f"expected a primitive or an operator: {EXPLAINED}",
            )
        fields["csg"] = tuple(nodes)

    def leaf(self, number: int, children: list[Token]) -> model.Leaf:
        """A primitive and its texture slots."""
        slots = [c for c in children[1:] if c.type != "NUMBER"]
        if len(slots) > 2:
            raise self.error(slots[2], f"found {quote(slots[2])}, a third texture; expected two at most")
        textures: list[model.Texture | None] = [None, None]
        for i, token in enumerate(slots):
            self.places["csg", number, "textures", i] = place(token)
            textures[i] = texture(token.type, str(token))
        numbers = [c for c in children[1:] if c.type == "NUMBER"]
        return model.Leaf(row(children[0]).name, self.index([children[0], *numbers]), (textures[0], textures[1]))

    def surface(self, fields: dict[str, Any], children: list[Any]) -> None:
        """SURFACE."""
        index = self.index(children)
        self.once(children[0], f"SURFACE {index}", "surfaces", index)
        values: dict[str, Any] = {}
        for item in _trees(children):
            if item.data == "material":
                self.material(values, _tokens(item), index)
            else:
                word, value = self.parameter(item, "surfaces", index)
                if word.name in ("exponent", "slope"):
                    self.once(_tokens(item)[0], "the roughness", "surfaces", index, "roughness")
                values[word.name] = value
        fields["surfaces"][index] = model.Surface(**values)
        checks.surface(Places(self.source, self.places), index, fields["surfaces"][index])

    def material(self, values: dict[str, Any], tokens: list[Token], index: int) -> None:
        """``material``, and ``metal`` or the metal's name after condutor, the glass's after dieletrico."""
        keyword, kind = tokens[:2]
        if keyword.type == "MATERIAL":
            self.once(keyword, "the material", "surfaces", index, "material")
            values["material"] = row(kind).name
        name = kind if keyword.type == "METAL" else tokens[2] if len(tokens) > 2 else None
        if name is not None and kind.type == "DIELECTRIC":
            self.glass(values, name, index)
        elif name is not None:
            self.once(name if keyword.type == "MATERIAL" else keyword, "the metal", "surfaces", index, "metal")
            values["metal"] = METALS.get(fold(name))
            if unknown := unknown_name(keyword.type if keyword.type == "METAL" else kind.type, name):
                raise self.error(name, unknown)
            values.setdefault("material", "conductor")

    def glass(self, values: dict[str, Any], name: Token, index: int) -> None:
        """The glass's name after dieletrico."""
        self.once(name, "the glass", "surfaces", index, "glass")
        values["glass"] = GLASSES.get(fold(name))
        if unknown := unknown_name("DIELECTRIC", name):
            raise self.error(name, unknown)

    def transform(self, fields: dict[str, Any], children: list[Any]) -> None:
        """TRANSFORM."""
        index = self.index(children)
        self.once(children[0], f"TRANSFORM {index}", "transforms", index)
        steps = []
        for item in _trees(children):
            tokens = _tokens(item)
            value = read_value(self.source, tokens)
            steps.append(model.Step(row(tokens[0]).name, value if isinstance(value, tuple) else (value,)))
        fields["transforms"][index] = model.Transform(tuple(steps))

    def texture(self, fields: dict[str, Any], children: list[Any]) -> None:
        """TEXTURE."""
        keyword, token, *rest = children
        name = _texture_name(token)
        self.once(keyword, f"TEXTURE {name}", "patterns", name)
        first = [c for c in rest if isinstance(c, Token)]  # the kind, if any; or brick as a parameter
        items = _trees(rest)
        if len(first) > 1:
            items.insert(0, Tree("parameter", [Token.new_borrow_pos("PARAMETER", str(first[0]), first[0]), *first[1:]]))
        kind = row(first[0]).name if len(first) == 1 else BUILT_IN.get(name)
        if kind is None:
            raise self.error(
                token,
                f"the texture {quote(token)} has no kind; expected brick, stripes or fractal after its "
                f"name{nearest(name, list(BUILT_IN))}",
            )
        parameters = []
        for item in items:
            keyword = _tokens(item)[0]
            if kind not in row(keyword).of:
                known = [word.canonical for word in of_role("PARAMETER") if kind in word.of]
                raise self.error(
                    keyword, f"found {quote(keyword)} in a texture of kind {kind}; expected {listing(known)}"
                )
            word, value = self.parameter(item, "patterns", name)
            parameters.append((word.name, value))
        fields["patterns"][name] = model.Pattern(kind, tuple(sorted(parameters)))


def texture(kind: str, word: str) -> model.Texture | None:
    """What a word in a primitive's texture slot says: the name of a texture, that of an image's file, or none."""
    if kind == "TEXTURE_NAME":
        return model.Texture(name=_texture_name(word))
    return model.Texture(image=word) if kind != "NULL" else None


def _trees(children: Iterable[Token | Node]) -> list[Node]:
    return [c for c in children if isinstance(c, Tree)]


def _tokens(item: Node) -> list[Token]:
    return [c for c in item.children if isinstance(c, Token) and c.type not in ("LPAR", "RPAR")]


def _texture_name(word: str) -> str:
    name = fold(word)
    return ALIASES.get(name, name)
