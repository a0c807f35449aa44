"""What messages suggest for a word or a mark that the language lacks: its meaning elsewhere, or a near word."""

import difflib
import re

from .diagnostics import CLIP, listing, quote
from .words import ALIASES, BUILT_IN, GLASSES, METALS, canonical, normalise, of_role, spellings

#: Each digit can be matched in one way only: a long number that ends in a letter takes no longer than others.
NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?"
BRACES = "braces hold arithmetic, as in {360 * $frame / 48}"
NO_BLOCKS = f"{BRACES}, and blocks need none: a statement goes on up to the next one"
SPACED = "expected numbers with nothing but spaces between them"
ENDLESS = "a statement ends where the next one begins, without a mark"
REMARK = "expected a remark to begin with #, or to stand in parentheses"
#: Numbers between commas, or between spaces. Where both are there, a comma may be a point, as in 0,5 0,5.
NUMBERS = re.compile(rf"\s*{NUMBER}(?:(?:\s*,\s*{NUMBER})+|(?:\s+{NUMBER})+)\s*", re.IGNORECASE)
#: What opens a vector elsewhere, and what stands in it.
BRACKETS = re.compile(r"[<\[]([^<>\[\]\n]*)(?:[>\]]|$)", re.MULTILINE)
#: A tag of XML.
TAG = re.compile(r"<[\w?!/]*[^\W\d]|<[?!/]")
#: What begins a block: nothing up to the line's end, or a word and what cannot follow it in arithmetic.
BLOCK = re.compile(r"(?:\s|[-+*]\s)*(?:$|<|[^\W\d][\w-]*(?:\s+[\w.<\"]|\s*=|\s*$))")
#: What may follow the last mark of a line.
REST_OF_LINE = re.compile(r"[^\S\n]*(?:$|#|//)", re.MULTILINE)
#: Remarks that do something in other languages: their word, and the name and the value that some of them give.
DIRECTIVE = re.compile(
    r"#\s*(?:(?P<gives>declare|local)\s+(?P<name>\w+)\s*=\s*(?P<value>[^;\n]*)"
    r"|(?P<defines>define)\s+(?P<macro>\w+)\s+(?P<text>[-+.\d\"(][^\n]*)"
    r"|(?P<includes>include)\s*[\"<]|(?P<makes>macro)\s+\w+\s*\()"
    r"|#(?:(?P<loops>while|for)\s*\(|(?P<chooses>if|ifdef|ifndef|elseif|switch)\s*\(|(?P<versions>version)\s+[\d.])"
)
#: What the language lacks, by the group of a directive that would be for it.
LACKS = {
    "includes": "a scene is one file",
    "makes": "the language has no macros",
    "loops": "the language has no loops, and what repeats is written out",
    "chooses": "the language has no conditions",
    "versions": "the language has no versions",
}


COLOURS = (
    "color colour cor rgb red green blue white black yellow grey gray vermelho verde azul branco preto amarelo cinza"
)
#: How the language says what other languages, and newcomers, say with other words.
HINTS_OF = (
    ("for glass: material dieletrico n-refr = 1.5, or its name, as in material dieletrico bk7",
     "glass vidro water agua diamond diamante crystal cristal transparent"),
    ("for a metal: material condutor and its name, such as ouro, prata, cobre, aluminio or cromo",
     "metal metals mirror espelho steel aco iron ferro brass latao chrome cromado bronze metallic platinum platina"),
    ("for a matt surface: material lambertiano kd = r g b; a texture such as t-fractal, or an image, goes after the "
     "primitive; for metals: material condutor and the metal's name",
     "wood madeira stone pedra marble marmore matte matt diffuse plaster gesso paper papel concrete"),
    ("for a varnished surface: material composto kd = r g b n-refr = 1.5",
     "plastic plastico paint tinta varnish verniz ceramic ceramica glossy"),
    ("the camera is VIEW, with OBS, VRP and WINDOW", "camera lookat look-at sensor"),
    ("the field of view follows from WINDOW and the distance from OBS to VRP", "fov zoom"),
    ("colours are three numbers from 0 to 1, such as kd = 1 0 0",
     COLOURS),
    ("for a box: CUBE", "box block caixa bloco"),
    ("for a ball: SPHERE", "ball bola globe"),
    ("for a plane: CUBE, made flat by SCALE", "plane plano floor chao ground wall parede"),
    ("the solids are CUBE, SPHERE, CYLINDER and CONE, what +, - and * make of these, and MESH with a file, PLY or OBJ",
     "torus toro donut rosca prism prisma pyramid piramide tetrahedron blob lathe sor text ply obj stl"),
    ("what a surface looks like is said by its index, as in SURFACE 0 kd = 1 0 0, or SURFACE 0 material condutor ouro",
     "pigment finish interior"),
    ("a union is +, before its operands", "union uniao"),
    ("a difference is -, before its operands", "difference diferenca subtract"),
    ("an intersection is *, before its operands", "intersection intersecao intersect"),
    ("rotations are ROTATE-X, ROTATE-Y and ROTATE-Z", "rotate rotacao rotation"),
    ("for a move: TRANSLATE (x y z)", "move translation"),
    ("the place of a light is position x y z, such as position 0 20 10", "pos location center centre centro lugar"),
    ("lights stand in LIGHTS, as AREA or POINT", "light luz lamp lampada sun sol emitter light_source"),
    ("for on: TRUE, as in CAUSTICS TRUE", "on ligado ligada enable enabled ativo ativado"),
    ("for off: FALSE, as in DO-SHADOW FALSE", "off desligado desligada disable disabled"),
    ("the index of refraction is n-refr, as in n-refr = 1.5", "ior eta index indice int_ior refraction refracao"),
)  # fmt: skip
#: Name of a statement -> what words mean within it that mean something else elsewhere, or nothing.
WITHIN = {
    "view": (
        ("the place of the eye is OBS x y z, such as OBS 0 16 40",
         "location pos position posicao origin from center centre centro lugar place"),
        ("the point that the eye looks at is VRP x y z, such as VRP 0 0 0",
         "look_at lookat look-at target to alvo direction direcao focus"),
        ("the field of view follows from WINDOW and the distance from OBS to VRP", "angle angulo"),
        ("what is upwards in the image is VUP x y z, such as VUP 0 1 0", "up sky"),
        ("the size of the image is RESOLUTION width height, such as RESOLUTION 640 480", "size width height tamanho"),
    ),
    "background": (
        ("its colour is three numbers on a scale of 65535, such as BACKGROUND 65535 65535 65535 for white", COLOURS),
    ),
    "ambient": (
        ("its colour is three numbers on a scale of 65535, such as AMBIENT 6000 6000 6000 for a dark grey", COLOURS),
    ),
    "lights": (
        ("the colour of a light is three numbers on a scale of 65535, such as Intensity 65535 65535 65535 for white",
         COLOURS),
    ),
}  # fmt: skip
#: The textures that exist without a statement, by all their names.
TEXTURES = [*BUILT_IN, *ALIASES]
#: Role of a word that a name may follow -> what that is the name of, and all names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
HINTS = {word: text for text, words in HINTS_OF for word in words.split()}
HINTS_WITHIN = {
    statement: {word: text for text, words in rows for word in words.split()} for statement, rows in WITHIN.items()
}


def hint(word: str, within: str = "") -> str:
    """``; `` and how the language says what a word means elsewhere, and ``within`` a statement there; or nothing."""
    text = HINTS_WITHIN.get(within, {}).get(normalise(word)) or HINTS.get(normalise(word))
    return f"; {text}" if text else ""


def hint_within(word: str, within: str) -> str:
    """``; `` and what a word of other statements is most likely meant for ``within`` this one, or nothing."""
    return hint(word, within) if normalise(word) in HINTS_WITHIN.get(within, {}) else ""


def nearest(word: str, words: list[str], cutoff: float = 0.7) -> str:
    """``; did you mean 'X'?`` for the known word nearest to ``word``, or nothing where none is near.

    Near are words that have most letters in common, in order, and short ones that have the same letters.
    """
    given = normalise(word)[:CLIP]
    folded = {normalise(w): w for w in words}
    near = difflib.get_close_matches(given, folded, n=1, cutoff=cutoff)
    near += [w for w in folded if len(w) == len(given) > 2 and sorted(w) == sorted(given)]
    return f"; did you mean {folded[near[0]]!r}?" if near else ""


def meant(word: str, fitting: set[str], within: str = "") -> str:
    """A hint, or else the nearest word of the language, of the roles that fit before all others; ``within``: the name
    of the statement that the word stands in.
    """
    known = spellings(*fitting) if fitting else []
    if "TEXTURE_NAME" in fitting:
        known += TEXTURES
    for material, names in (("CONDUCTOR", METALS), ("DIELECTRIC", GLASSES)):
        if fitting & {material, "MATERIAL"} and normalise(word) in names:
            return f"; did you mean '{canonical(material)} {word}'?"
    return hint(word, within) or nearest(word, known) or nearest(word, spellings())


def unknown_name(role: str, word: str) -> str | None:
    """What to say of a word after one of ``role`` that is to be the name of a metal or a glass, and is that of none;
    None of a name, and after other roles.
    """
    what, names = NAMED.get(role, ("", {}))
    if not what or normalise(word) in names or word.startswith("$"):
        return None
    first: dict[str, str] = {}
    for name, table in names.items():
        first.setdefault(table.split("_")[0], name)
    allowed = listing(first.values())
    optics: list[str] = []
    if role != "METAL":
        kind = of_role(role)[0].name
        optics = [s for row in of_role("OPTIC") if not row.of or kind in row.of for s in row.spellings]
        allowed += ", or n-refr" if kind == "dielectric" else ", or n-refr and k-abs"
    other = "DIELECTRIC" if what == "metal" else "CONDUCTOR"
    near = nearest(word, [*names, *optics])
    if normalise(word) in NAMED[other][1]:
        near = f"; did you mean '{canonical(other)} {word}'?"
    return f"unknown {what} {quote(word)}; expected {allowed}{hint(word) or near}"


def spaced(text: str) -> str | None:
    """Two numbers or more between commas or spaces, as this language writes them; None for all else."""
    return " ".join(re.split(r"\s*,\s*|\s+", text.strip())) if NUMBERS.fullmatch(text) else None


def of_mark(text: str, start: int, found: str) -> str | None:
    """What to say of a word that has no place where it stands, which is at ``start`` of a text; None of most."""
    if TAG.match(text, start):
        return "that is no scene in this language; expected a name that ends in .xml of a file in Mitsuba's"
    if text.startswith("--", start) or "//" in found or "/*" in found or found[0] in "%!":
        return REMARK
    if found[-1] == ";" and REST_OF_LINE.match(text, start + len(found)):
        return ENDLESS
    if found[0] in "<[":
        inside = BRACKETS.match(text, start)
        numbers = spaced(inside[1]) if inside else None
        return f"{SPACED}, and no brackets" + (f": {numbers}" if numbers else ", as in 1 2 3")
    return NO_BLOCKS if found[0] in "{}" else None


def of_braces(inside: str) -> str | None:
    """What to say of what stands in braces and is no arithmetic; None where it is most likely meant as such."""
    numbers = spaced(inside)
    if numbers and numbers.count(" ") > 1:  # two may be a fraction, as 0,5, or lack an operator
        return f"{BRACES}; {SPACED}, and no braces: {numbers}"
    return NO_BLOCKS if BLOCK.match(inside) else None


def of_comment(text: str) -> str | None:
    """What to say of a comment that would do something in another language; None of most."""
    found = DIRECTIVE.match(text)
    if found is None:
        return None
    begin = "this line is a remark, as all that begins with # is"
    for group, lack in LACKS.items():
        if found[group]:
            return f"{begin}; {lack}"
    name, value = (found["name"], found["value"]) if found["gives"] else (found["macro"], found["text"])
    return f"{begin}; a name gets its value by DEFAULT ${name} = {value.strip()[:60]}, and is written ${name}"
