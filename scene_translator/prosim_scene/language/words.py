"""The words of the language: one table, in which each word has its row; and the names of metals, glasses and textures.

A row has the *role* of the word in the grammar, its spellings, its name in the model, and the numbers that follow it.
Case and accents do not matter; English and Portuguese may be mixed. A word with several roles has a row for each, and
the grammar selects the row.
"""

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

#: Lengths are between 1 / LARGE and LARGE, so that Mitsuba's single precision holds their squares.
LARGE = 1e15


@dataclass(frozen=True)
class Numbers:
    """The numbers that follow a word: how many, their names in messages, and their range."""

    count: int = 1
    what: str = ""
    low: float = 0
    high: float = 1
    whole: bool = False
    channels: bool = False  #: r g b, or one for all channels
    direction: bool = False  #: a vector that may not have length 0
    least: float = 0  #: the smallest magnitude, except 0
    nonzero: bool = False  #: whether 0 is refused

    noun: ClassVar = "number"

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} number{'s' * (self.count > 1)} ({self.what})" + ", or 1 for all channels" * self.channels

    def bounds(self) -> str:
        """The allowed values, in words."""
        kind = "a whole number, " if self.whole else ""
        magnitude = "a magnitude of " if self.low < 0 else ""
        low = max(self.low, self.least)
        least = f"{low:g} or more, " if low > 0 or not magnitude else ""
        zero = "0, or " if self.least and not self.nonzero else ""
        return f"{zero}{kind}{magnitude}{least}{self.high:.10g} at most"

    def fit(self, count: int) -> bool:
        """Whether this is an allowed count of values."""
        return count == self.count or (self.channels and count == 1)

    def allow(self, text: str) -> bool:
        """Whether a value is allowed."""
        value = float(text)
        return (
            self.low <= value <= self.high
            and (abs(value) >= self.least or (value == 0 and not self.nonzero))
            and (not self.whole or value == int(value))
        )

    def convert(self, text: str) -> Any:
        """The value of an allowed text."""
        return int(float(text)) if self.whole else float(text)

    def value(self, texts: Sequence[str]) -> Any:
        """The values: one, or a tuple; None if their count is wrong, or one is not allowed."""
        if not self.fit(len(texts)) or not all(map(self.allow, texts)):
            return None
        values = tuple(map(self.convert, texts))
        if self.direction and math.hypot(*values) < 1 / LARGE:
            return None
        return values[0] if self.count == 1 else values * (self.count // len(values))


class Flags(Numbers):
    """The TRUE or FALSE, or 1 or 0, that follow a word: how many, and their names in messages."""

    noun = "word"

    def counted(self) -> str:
        """How many there are, in words."""
        return f"{self.count} words, each TRUE or FALSE ({self.what})" if self.count > 1 else self.bounds()

    def bounds(self) -> str:
        """The allowed values, in words."""
        return "TRUE or FALSE"

    def allow(self, text: str) -> bool:
        """Whether a value is allowed."""
        return normalise(text) in FLAGS

    def convert(self, text: str) -> bool:
        """The value of an allowed text."""
        return FLAGS[normalise(text)]


NOTHING = Numbers(0)


@dataclass(frozen=True)
class Word:
    """A row of the table.

    ``name`` is the field of the model that the word sets, or its value; ``of`` are the kinds of lights, materials or
    patterns that have the word (empty: all).
    """

    role: str
    spellings: tuple[str, ...]
    name: str = ""
    takes: Numbers = NOTHING
    of: tuple[str, ...] = ()

    @property
    def canonical(self) -> str:
        """The spelling that messages and the formatter use."""
        return self.spellings[0]


def _word(role: str, spellings: str, name: str = "", takes: Numbers = NOTHING, of: str = "") -> Word:
    return Word(role, tuple(spellings.split()), name, takes, tuple(of.split()))


#: The largest number of pixels of an image.
PIXELS = 2**28

INDEX = Numbers(1, "its index", 0, 10**9 - 1, whole=True)
POINT = Numbers(3, "x y z", -LARGE, LARGE)
DIRECTION = Numbers(3, "x y z", -LARGE, LARGE, direction=True)
DEGREES = Numbers(1, "degrees", -1e9, 1e9)
INTENSITY = Numbers(3, "r g b", 0, 1e15)
COLOR = Numbers(3, "r g b", 0, 1e6, channels=True)
REFLECTANCE = Numbers(3, "r g b", 0, 1, channels=True)
ETA = Numbers(3, "r g b", 1e-3, 1e3, channels=True)
ABSORPTION = Numbers(3, "r g b", 0, 1e3, channels=True)
TRANSMITTANCE = Numbers(3, "r g b", 1e-6, 1, channels=True)
FRACTION = Numbers(1, "a fraction", 0, 1)
LENGTH = Numbers(1, "a length", 1e-6, 1e6)

ROUGH = "conductor dielectric composite phong"  # "phong": no material is given

WORDS = (
    # statements
    _word("DEFAULT", "DEFAULT PADRAO", "defaults"),
    _word("NAME", "NAME NOME", "name"),
    _word("SETTING", "SAVE-RGB SALVA-RGB", "channels", Flags(3, "r g b")),
    _word("SETTING", "MAX-LEVEL NIVEL-MAX NIVEL-MAXIMO", "max_level", Numbers(1, "a level", 0, 24, whole=True)),
    _word("SETTING", "NSAMPLES NAMOSTRAS", "samples", Numbers(1, "the number N", 1, 1000, whole=True)),
    _word("SETTING", "DO-SHADOW SHADOW SOMBRA SOMBRAS", "shadows", Flags()),
    _word("SETTING", "CAUSTICS CAUSTICAS", "caustics", Flags()),
    _word("SETTING", "AIR-INDEX INDICE-AR", "air_index", Numbers(1, "the index of refraction", 1e-3, 1e3)),
    _word("SETTING", "AMBIENT AMBIENTE", "ambient", INTENSITY),
    _word("LIGHTS", "LIGHTS LUZES FONTES", "lights"),
    _word("BACKGROUND", "BACKGROUND FUNDO", "background", INTENSITY),
    _word("VIEW", "VIEW VISTA", "view"),
    _word("SOLID", "SOLID SOLIDO", "solids"),
    _word("CSG_TREE", "CSG-TREE ARVORE-CSG CSG", "csg"),
    _word("SURFACE", "SURFACE SUPERFICIE", "surfaces", INDEX),
    _word("TRANSFORM", "TRANSFORM TRANSFORMACAO", "transforms", INDEX),
    _word("TEXTURE", "TEXTURE TEXTURA", "patterns"),
    _word("END", "END FIM"),
    # lights
    _word("LIGHT", "AREA EXTENSA", "area"),
    _word("LIGHT", "POINT PONTO PONTUAL", "point"),
    _word("LIGHT", "SKY CEU", "sky"),
    _word("LIGHT_PARAMETER", "position posicao", "position", POINT),
    _word("LIGHT_PARAMETER", "Intensity intensidade", "intensity", INTENSITY),
    _word("LIGHT_PARAMETER", "raio radius", "radius", Numbers(1, "the radius", 1 / LARGE, LARGE)),
    _word("LIGHT_PARAMETER", "direction direcao", "direction", DIRECTION, "cone spot"),
    _word("LIGHT_PARAMETER", "angle angulo", "angle", Numbers(1, "degrees", 0.05, 180), "cone spot"),
    _word("LIGHT_PARAMETER", "exponent expoente", "exponent", Numbers(1, "n", 0, 1e6), "spot"),
    _word("DISTRIBUTION", "UNIFORM UNIFORME", "uniform"),
    _word("DISTRIBUTION", "CONE", "cone"),
    _word("DISTRIBUTION", "SPOT", "spot"),
    # view
    _word("VIEW_PARAMETER", "RESOLUTION RESOLUCAO", "resolution", Numbers(2, "width height", 1, 65536, whole=True)),
    _word("VIEW_PARAMETER", "WINDOW JANELA", "window", Numbers(4, "umin vmin umax vmax", -LARGE, LARGE)),
    _word("VIEW_PARAMETER", "OBS OBSERVER OBSERVADOR EYE OLHO", "eye", POINT),
    _word("VIEW_PARAMETER", "VPN", "vpn", POINT),
    _word("VIEW_PARAMETER", "VRP", "vrp", POINT),
    _word("VIEW_PARAMETER", "VUP", "vup", POINT),
    # the tree
    _word("PRIMITIVE", "CUBE CUBO", "cube", INDEX),
    _word("PRIMITIVE", "SPHERE ESFERA", "sphere", INDEX),
    _word("PRIMITIVE", "CYLINDER CILINDRO", "cylinder", INDEX),
    _word("PRIMITIVE", "CONE", "cone", INDEX),
    _word("PRIMITIVE", "MESH MALHA", "mesh", INDEX),
    # surfaces
    _word("MATERIAL", "material", "material"),
    _word("CONDUCTOR", "condutor conductor", "conductor"),
    _word("DIELECTRIC", "dieletrico dielectric", "dielectric"),
    _word("MATERIAL_KIND", "lambertiano lambertian", "lambertian"),
    _word("MATERIAL_KIND", "composto composite", "composite"),
    _word("METAL", "metal", "metal", of="conductor"),
    _word("OPTIC", "ka", "ka", COLOR),
    _word("OPTIC", "kd", "kd", REFLECTANCE, "lambertian composite phong"),
    _word("OPTIC", "ks", "ks", REFLECTANCE, "composite phong"),
    _word("OPTIC", "n-refr n-refraction", "eta", ETA, "conductor dielectric composite"),
    _word("OPTIC", "k-abs k-absorption", "k", ABSORPTION, "conductor"),
    _word("OPTIC", "abbe", "abbe", Numbers(1, "the Abbe number", 1, 1000), "dielectric"),
    _word("OPTIC", "transmitancia transmittance", "transmittance", TRANSMITTANCE, "dielectric"),
    _word("OPTIC", "espessura thickness", "thickness", LENGTH, "dielectric"),
    _word("OPTIC", "n", "exponent", Numbers(1, "n", 0, 1e6), ROUGH),
    _word("OPTIC", "rug rugosidade roughness", "exponent", Numbers(1, "a Phong exponent", 0, 1e6), ROUGH),
    _word("OPTIC", "m", "slope", Numbers(1, "the RMS slope", 0, 1e3, least=1e-4), ROUGH),
    # transforms
    _word("STEP", "SCALE ESCALA", "scale", Numbers(3, "x y z", -LARGE, LARGE, least=1 / LARGE, nonzero=True)),
    _word("STEP", "ROTATE-X ROTACAO-X GIRA-X", "rotate-x", DEGREES),
    _word("STEP", "ROTATE-Y ROTACAO-Y GIRA-Y", "rotate-y", DEGREES),
    _word("STEP", "ROTATE-Z ROTACAO-Z GIRA-Z", "rotate-z", DEGREES),
    _word("STEP", "TRANSLATE TRANSLACAO TRANSLADA", "translate", POINT),
    # textures
    _word("KIND", "brick tijolo", "brick"),
    _word("KIND", "stripes listra listras", "stripes"),
    _word("KIND", "fractal", "fractal"),
    _word("PARAMETER", "brick tijolo", "brick", COLOR, "brick"),
    _word("PARAMETER", "mortar argamassa", "mortar", COLOR, "brick"),
    _word("PARAMETER", "brick-width largura-tijolo", "brick_width", LENGTH, "brick"),
    _word("PARAMETER", "brick-height altura-tijolo", "brick_height", LENGTH, "brick"),
    _word("PARAMETER", "mortar-width largura-argamassa", "mortar_width", Numbers(1, "a length", 0, 1e6), "brick"),
    _word("PARAMETER", "stagger defasagem", "stagger", FRACTION, "brick"),
    _word("PARAMETER", "color0 cor0", "color0", COLOR, "stripes fractal"),
    _word("PARAMETER", "color1 cor1", "color1", COLOR, "stripes fractal"),
    _word("PARAMETER", "frequency frequencia", "frequency", Numbers(1, "pairs a unit", 1e-6, 1e6), "stripes"),
    _word("PARAMETER", "duty razao", "duty", FRACTION, "stripes"),
    _word("PARAMETER", "axis eixo", "axis", DIRECTION, "stripes"),
    _word("PARAMETER", "scale escala", "scale", Numbers(1, "a frequency", 1e-6, 1e6), "fractal"),
    _word("PARAMETER", "octaves oitavas", "octaves", Numbers(1, "a number", 1, 16, whole=True), "fractal"),
    _word("PARAMETER", "gain ganho", "gain", Numbers(1, "a factor", 0, 1e6), "fractal"),
    _word("PARAMETER", "lacunarity lacunaridade", "lacunarity", Numbers(1, "a factor", 1e-6, 1e6), "fractal"),
    _word("PARAMETER", "seed semente", "seed", Numbers(1, "a number", 0, 2**31 - 1, whole=True), "fractal"),
    # values
    _word("BOOL", "TRUE VERDADEIRO SIM YES", "true"),
    _word("BOOL", "FALSE FALSO NAO NO", "false"),
    _word("NULL", "NULL NULO NENHUM NENHUMA NONE"),
)

#: The names in messages of BOOL and of tokens that are not words.
MEANINGS = {
    "NUMBER": "a number",
    "VARIABLE": "a name such as $angle",
    "WORD": "a word",
    "STRING": "a quoted string",
    "FILE": "a file name",
    "TEXTURE_NAME": "a texture's name (t-...)",
    "PLUS": "+",
    "MINUS": "-",
    "TIMES": "*",
    "LPAR": "(",
    "RPAR": ")",
    "BOOL": "TRUE or FALSE",
}
OPERATORS = {"+": "PLUS", "-": "MINUS", "*": "TIMES"}
MARKS = OPERATORS | {"(": "LPAR", ")": "RPAR"}
#: The roles of keywords that begin a statement, and of the words that belong to one.
STATEMENTS = frozenset(
    {"DEFAULT", "NAME", "SETTING", "LIGHTS", "BACKGROUND", "VIEW"}
    | {"SOLID", "CSG_TREE", "SURFACE", "TRANSFORM", "TEXTURE", "END"}
)
PARTS = {
    "LIGHTS": "LIGHT LIGHT_PARAMETER DISTRIBUTION",
    "VIEW": "VIEW_PARAMETER",
    "CSG_TREE": "PRIMITIVE",
    "SURFACE": "MATERIAL CONDUCTOR DIELECTRIC MATERIAL_KIND METAL OPTIC",
    "TRANSFORM": "STEP",
    "TEXTURE": "KIND PARAMETER",
}
STATEMENT_OF = {role: statement for statement, roles in PARTS.items() for role in roles.split()}
KIND_ROLES = ("DISTRIBUTION", "CONDUCTOR", "DIELECTRIC", "MATERIAL_KIND", "KIND")
ROLES = tuple(dict.fromkeys(word.role for word in WORDS))
#: The order in which a message lists what it expected.
ORDER = ("NUMBER", "VARIABLE", *OPERATORS.values(), *ROLES, "TEXTURE_NAME", "FILE", "STRING", "WORD", "LPAR", "RPAR")

#: Names of metals, by the tables that Mitsuba ships (Palik's handbook first: it is the thesis's own source).
METAL_NAMES = {
    "Cu_palik": "copper cobre",
    "Au": "gold ouro",
    "Ag": "silver prata",
    "Al": "aluminium aluminum aluminio",
    "Cr": "chromium cromo",
    "Ni_palik": "nickel niquel ni",
    "W": "tungsten tungstenio",
    "Hg_palik": "mercury mercurio",
    "Be_palik": "beryllium berilio be",
    "Ir_palik": "iridium iridio",
    "Mo_palik": "molybdenum molibdenio",
    "Nb_palik": "niobium niobio",
    "Rh_palik": "rhodium rodio",
    "Ta_palik": "tantalum tantalo",
    "V_palik": "vanadium vanadio v",
    "Na_palik": "sodium sodio na",
    "Li_palik": "lithium litio",
    "K_palik": "potassium potassio",
}
METALS = {name: table for table, names in METAL_NAMES.items() for name in names.split()}
METALS |= {table.lower(): table for table in (*METAL_NAMES, *["Cu", "Hg", "Ir", "K", "Li", "Mo", "Nb", "Rh", "Ta"])}
#: Names of glasses and other clear materials, by the materials of prosim_dielectric; and their indices of refraction at
#: the line d, 587.6 nm.
GLASS_NAMES = {
    "bk7": "bk7 n-bk7",
    "f2": "f2",
    "sf10": "sf10",
    "sf11": "sf11",
    "lasf9": "lasf9 n-lasf9",
    "silica": "silica quartz quartzo",
    "diamond": "diamond diamante",
    "zirconia": "zirconia",
    "water": "water agua",
}
GLASSES = {name: glass for glass, names in GLASS_NAMES.items() for name in names.split()}
#: Role of a word before a name -> the field of the model, and the names.
NAMED = {"CONDUCTOR": ("metal", METALS), "METAL": ("metal", METALS), "DIELECTRIC": ("glass", GLASSES)}
INDICES = dict(zip(GLASS_NAMES, (1.5168, 1.62004, 1.72825, 1.78472, 1.85025, 1.45846, 2.41749, 2.15877, 1.3334)))
#: The predefined textures with their kinds, and aliases of their names.
BUILT_IN = {"t-tijolo": "brick", "t-listra": "stripes", "t-fractal": "fractal"}
ALIASES = {"t-brick": "t-tijolo", "t-stripes": "t-listra", "t-listras": "t-listra"}


def normalise(word: str) -> str:
    """Lower case without accents: the form in which words are compared."""
    if word.isascii():
        return word.lower()
    return "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c)).lower()


#: The rows of each normalised spelling, in the order of the table.
ROWS: dict[str, list[Word]] = {}
for _row in WORDS:
    for _spelling in _row.spellings:
        ROWS.setdefault(normalise(_spelling), []).append(_row)


#: TRUE and FALSE, and 1 and 0, by their normalised spellings.
FLAGS = {normalise(s): word.name == "true" for word in WORDS if word.role == "BOOL" for s in word.spellings}
FLAGS |= {"0": False, "1": True}
#: The canonical spellings of kinds of lights, materials and textures; a material may also be absent.
KINDS = {word.name: word.canonical for word in WORDS if word.role in KIND_ROLES} | {
    "phong": "a surface without a material"
}


@lru_cache(maxsize=1 << 10)
def row(role: str, spelling: str) -> Word:
    """The row of a keyword."""
    return next(word for word in ROWS[normalise(spelling)] if word.role == role)


def of_role(*roles: str) -> list[Word]:
    """The rows of some roles."""
    return [word for word in WORDS if word.role in roles]


def spellings(*roles: str) -> list[str]:
    """All spellings of some roles; without arguments, of all roles."""
    return [spelling for word in WORDS if not roles or word.role in roles for spelling in word.spellings]


def numbers(role: str, name: str) -> Numbers:
    """The numbers that the model's ``name`` takes."""
    return next(word.takes for word in WORDS if (word.role, word.name) == (role, name))


@lru_cache(maxsize=1 << 8)
def canonical(role: str, name: str = "") -> str:
    """The canonical spelling of the model's ``name``; without a name, that of the first word of the role."""
    return next(word.canonical for word in WORDS if word.role == role and name in ("", word.name))


def meanings(role: str) -> list[str]:
    """The words that fit where the grammar expects ``role``, for messages."""
    return [MEANINGS[role]] if role in MEANINGS else [word.canonical for word in of_role(role)]


def texture_name(word: str) -> str:
    """The name of a texture in the model."""
    name = normalise(word)
    return ALIASES.get(name, name)
