"""What to say of a word that the language does not have: its meaning in other languages, or a word that is near."""

import difflib

from .messages import CLIP, listing, quote
from .names import ALIASES, BUILT_IN, GLASSES, METALS
from .words import WORDS, canonical, fold, of_role

COLOURS = (
    "color colour cor rgb red green blue white black yellow grey gray vermelho verde azul branco preto amarelo cinza"
)
#: How the language says what other languages, and newcomers, say with other words.
SAID = (
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
    ("the solids are CUBE, SPHERE, CYLINDER and CONE, and what +, - and * make of these",
     "torus toro donut rosca prism prisma pyramid piramide tetrahedron blob lathe sor text mesh malha"),
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
#: Role of a word that may be followed by a name -> what that is the name of, and all names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
HINTS = {word: said for said, words in SAID for word in words.split()}
HINTS_WITHIN = {
    statement: {word: said for said, words in rows for word in words.split()} for statement, rows in WITHIN.items()
}


def hint(word: str, within: str = "") -> str:
    """``; `` and how the language says what a word means elsewhere, and ``within`` a statement there; or nothing."""
    text = HINTS_WITHIN.get(within, {}).get(fold(word)) or HINTS.get(fold(word))
    return f"; {text}" if text else ""


def hint_within(word: str, within: str) -> str:
    """``; `` and what a word of other statements is most likely meant for ``within`` this one, or nothing."""
    return hint(word, within) if fold(word) in HINTS_WITHIN.get(within, {}) else ""


def nearest(word: str, words: list[str], cutoff: float = 0.7) -> str:
    """``; did you mean 'X'?`` for the known word nearest to ``word``, or nothing where none is near.

    Near are words that have most letters in common, in order, and short ones that have the same letters.
    """
    given = fold(word)[:CLIP]
    folded = {fold(w): w for w in words}
    near = difflib.get_close_matches(given, folded, n=1, cutoff=cutoff)
    near += [w for w in folded if len(w) == len(given) > 2 and sorted(w) == sorted(given)]
    return f"; did you mean {folded[near[0]]!r}?" if near else ""


def meant(word: str, fitting: set[str], within: str = "") -> str:
    """A hint, or else the nearest word of the language, of the roles that fit before all others; ``within``: the name
    of the statement that the word stands in.
    """
    known = [spelling for row in WORDS if row.role in fitting for spelling in row.spellings]
    if "TEXTURE_NAME" in fitting:
        known += TEXTURES
    for material, names in (("CONDUCTOR", METALS), ("DIELECTRIC", GLASSES)):
        if fitting & {material, "MATERIAL"} and fold(word) in names:
            return f"; did you mean '{canonical(material, '')} {word}'?"
    every = [spelling for row in WORDS for spelling in row.spellings]
    return hint(word, within) or nearest(word, known) or nearest(word, every)


def unknown_name(role: str, word: str) -> str | None:
    """What to say of a word after one of ``role`` that is to be the name of a metal or a glass, and is that of none;
    None of a name, and after other roles.
    """
    what, names = NAMED.get(role, ("", {}))
    if not what or fold(word) in names or word.startswith("$"):
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
    if fold(word) in NAMED[other][1]:
        near = f"; did you mean '{canonical(other)} {word}'?"
    return f"unknown {what} {quote(word)}; expected {allowed}{hint(word) or near}"
