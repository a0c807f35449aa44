"""The suggestion at the end of a message: the nearest known word, or how this language writes what others write."""

import difflib
import re
from collections.abc import Collection, Iterable

from .diagnostics import CLIP, listing, quote
from .words import ALIASES, BUILT_IN, NAMED, canonical, normalise, of_role, spellings

#: Each digit can be matched in one way only, so that the time grows no faster than the length.
NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?"
BRACES = "braces hold arithmetic, as in {360 * $frame / 48}; vectors and blocks have none"
#: Marks of other languages, by a pattern of the text from there on, and how this language does without them.
MARKS = [
    (re.compile(pattern, re.IGNORECASE | re.MULTILINE), text)
    for pattern, text in (
        (r"<[?!/]|<[\w]*[^\W\d]", "this is XML; expected a scene in this language, or a file name that ends in .xml"),
        (r"--|[%!]|[^\s()]*(?://|/\*)", "expected a comment to begin with #, or to stand in parentheses"),
        (r"[^\s;]*;[^\S\n]*(?:$|#|//)", "a statement ends where the next one begins, without a mark"),
        (r"[<\[]", "expected numbers with nothing but spaces between them, and no brackets, as in 1 2 3"),
        (r"[{}]", BRACES),
        (
            r"[-+.e\d]*[,;]",
            "expected numbers with nothing but spaces between them, as in 1 2 3, and a point, as in 0.5",
        ),
        (r"[-+.\d]+[x×][-+.\d]+", "expected numbers with nothing but spaces between them, as in 320 240"),
    )
]
#: An operator, but for the sign of a number or of its exponent.
ARITHMETIC = re.compile(r"[*/^$]|^[-+]$|(?<=[\d.])[-+]")

COLOURS = "color colour cor rgb red green blue white black yellow grey gray vermelho verde azul branco preto amarelo"
#: How the language says what other languages, and newcomers, say with other words.
HINTS_OF = (
    ("glass is material dieletrico n-refr = 1.5, or its name, as in material dieletrico bk7",
     "glass vidro water agua diamond diamante crystal cristal transparent"),
    ("a metal is material condutor and its name: ouro, prata, cobre, aluminio, cromo, ...",
     "metal metals mirror espelho steel aco iron ferro brass latao chrome bronze metallic platinum"),
    ("a matt surface is material lambertiano kd = r g b; a texture, such as t-fractal, stands after the primitive; "
     "a metal is material condutor and its name", "wood madeira stone pedra marble marmore matte matt diffuse plaster"),
    ("a varnished surface is material composto kd = r g b n-refr = 1.5", "plastic plastico paint tinta varnish glossy"),
    ("the camera is VIEW, with OBS, VRP and WINDOW", "camera lookat look-at look_at sensor"),
    ("the field of view follows from WINDOW and the distance from OBS to VRP", "fov zoom"),
    ("a colour is three numbers from 0 to 1, such as kd = 1 0 0", COLOURS),
    ("the solids are CUBE, SPHERE, CYLINDER, CONE and MESH; a box and a plane are a CUBE with a SCALE",
     "box block caixa bloco ball bola plane plano floor chao wall torus toro prism prisma pyramid piramide blob lathe"),
    ("SURFACE and the index of a primitive say its optics, as in SURFACE 0 kd = 1 0 0", "pigment finish interior"),
    ("the operators are + (union), - (difference) and * (intersection), before their operands",
     "union uniao difference diferenca subtract intersection intersecao intersect"),
    ("the steps are SCALE, ROTATE-X, ROTATE-Y, ROTATE-Z and TRANSLATE", "rotate rotacao rotation move translation"),
    ("the place of a light is position x y z, such as position 0 20 10", "pos location center centre centro lugar"),
    ("lights stand in LIGHTS, as AREA or POINT", "light luz lamp lampada sun sol emitter light_source spot"),
    ("write TRUE", "on ligado ligada enable enabled ativo"),
    ("write FALSE", "off desligado desligada disable disabled"),
    ("the index of refraction is n-refr, as in n-refr = 1.5", "ior eta index indice int_ior refraction refracao"),
)  # fmt: skip
#: Name of a statement -> the same for the words that mean something else there, or nothing elsewhere.
HINTS_WITHIN = {
    "view": (
        ("the place of the eye is OBS x y z, such as OBS 0 16 40", "location pos position posicao origin from center"),
        ("the point that the eye looks at is VRP x y z, such as VRP 0 0 0",
         "look_at lookat look-at target to alvo direction direcao"),
        ("the field of view follows from WINDOW and the distance from OBS to VRP", "angle angulo"),
        ("the upward direction of the image is VUP x y z, such as VUP 0 1 0", "up sky"),
        ("the size of the image is RESOLUTION width height, such as RESOLUTION 640 480", "size width height"),
    ),
    "background": (("65535 is 1.0, as in BACKGROUND 65535 65535 65535 for white", COLOURS),),
    "ambient": (("65535 is 1.0, as in AMBIENT 6000 6000 6000 for a dark grey", COLOURS),),
    "lights": (("the colour of a light is Intensity, as in Intensity 65535 65535 65535 for white", COLOURS),),
}  # fmt: skip
HINTS = {
    (statement, word): text
    for statement, rows in {"": HINTS_OF, **HINTS_WITHIN}.items()
    for text, words in rows
    for word in words.split()
}
#: The textures that exist without a statement, by all their names.
TEXTURES = [*BUILT_IN, *ALIASES]


def hint(word: str, within: str = "") -> str:
    """``; `` and how the language says what a word means elsewhere; ``within``: the name of the statement around it."""
    text = HINTS.get((within, normalise(word))) or HINTS.get(("", normalise(word)))
    return f"; {text}" if text else ""


def nearest(word: str, words: Iterable[str], cutoff: float = 0.7) -> str:
    """``; did you mean 'X'?`` for the known word nearest to ``word``, or nothing if none is near.

    Near are words that have most letters in common, in order, and short ones that have the same letters.
    """
    given = normalise(word)[:CLIP]
    known = {normalise(w): w for w in words}
    near = difflib.get_close_matches(given, known, n=1, cutoff=cutoff)
    near += [w for w in known if len(w) == len(given) > 2 and sorted(w) == sorted(given)]
    return f"; did you mean {known[near[0]]!r}?" if near else ""


def meant(word: str, roles: Collection[str], within: str = "") -> str:
    """The suggestion for a word where one of these ``roles`` is expected: a hint, or the nearest word."""
    fitting = [*(spellings(*roles) if roles else []), *(TEXTURES if "TEXTURE_NAME" in roles else [])]
    for material, (_, names) in NAMED.items():
        if {material, "MATERIAL"} & set(roles) and normalise(word) in names:
            return f"; did you mean '{canonical(material)} {word}'?"
    return hint(word, within) or nearest(word, fitting) or nearest(word, spellings())


def unknown_name(role: str, word: str) -> str:
    """The reason of the error about a word that is no name of a metal, or of a glass; it stands after ``role``."""
    what, names = NAMED[role]
    first: dict[str, str] = {}
    for name, table in names.items():
        first.setdefault(table.split("_")[0], name)
    optics = [] if role == "METAL" else [s for row in of_role("OPTIC") for s in row.spellings]
    allowed = [*first.values(), *["n-refr"] * (role != "METAL")]
    other = "DIELECTRIC" if what == "metal" else "CONDUCTOR"
    near = nearest(word, [*names, *optics])
    if normalise(word) in NAMED[other][1]:
        near = f"; did you mean '{canonical(other)} {word}'?"
    return f"unknown {what} {quote(word)}; expected {listing(allowed)}{hint(word) or near}"


def of_mark(text: str, start: int) -> str:
    """``; `` and how the language does without the mark of another language at ``start``; nothing for other text."""
    return next((f"; {instead}" for pattern, instead in MARKS if pattern.match(text, start)), "")
