"""Names that are no words of the language: metals, and the textures that exist without a statement."""

#: Names of metals -> the tables that Mitsuba ships (Palik's handbook first: it is the thesis's own source).
METALS = {
    "copper": "Cu_palik",
    "cobre": "Cu_palik",
    "gold": "Au",
    "ouro": "Au",
    "silver": "Ag",
    "prata": "Ag",
    "aluminium": "Al",
    "aluminum": "Al",
    "aluminio": "Al",
    "chromium": "Cr",
    "cromo": "Cr",
    "nickel": "Ni_palik",
    "niquel": "Ni_palik",
    "tungsten": "W",
    "tungstenio": "W",
    "mercury": "Hg_palik",
    "mercurio": "Hg_palik",
    "beryllium": "Be_palik",
    "berilio": "Be_palik",
    "iridium": "Ir_palik",
    "iridio": "Ir_palik",
    "molybdenum": "Mo_palik",
    "molibdenio": "Mo_palik",
    "niobium": "Nb_palik",
    "niobio": "Nb_palik",
    "rhodium": "Rh_palik",
    "rodio": "Rh_palik",
    "tantalum": "Ta_palik",
    "tantalo": "Ta_palik",
    "vanadium": "V_palik",
    "vanadio": "V_palik",
    "sodium": "Na_palik",
    "sodio": "Na_palik",
    "lithium": "Li_palik",
    "litio": "Li_palik",
    "potassium": "K_palik",
    "potassio": "K_palik",
}
TABLES = (
    "Ag Al Au Be_palik Cr Cu Cu_palik Hg Hg_palik Ir Ir_palik K K_palik Li Li_palik Mo Mo_palik Na_palik Nb Nb_palik "
    "Ni_palik Rh Rh_palik Ta Ta_palik V_palik W"
)
METALS |= {table.lower(): table for table in TABLES.split()}
METALS |= {"na": "Na_palik", "ni": "Ni_palik", "be": "Be_palik", "v": "V_palik"}

#: Names of glasses, and of what else is clear -> the materials of prosim_dielectric.
GLASSES = {
    "bk7": "bk7",
    "n-bk7": "bk7",
    "f2": "f2",
    "sf10": "sf10",
    "sf11": "sf11",
    "lasf9": "lasf9",
    "n-lasf9": "lasf9",
    "silica": "silica",
    "quartz": "silica",
    "quartzo": "silica",
    "diamond": "diamond",
    "diamante": "diamond",
    "zirconia": "zirconia",
    "water": "water",
    "agua": "water",
}
#: The index of each at the line d, 587.6 nm.
INDICES = {
    "bk7": 1.5168,
    "f2": 1.62004,
    "sf10": 1.72825,
    "sf11": 1.78472,
    "lasf9": 1.85025,
    "silica": 1.45846,
    "diamond": 2.41749,
    "zirconia": 2.15877,
    "water": 1.3334,
}

#: The textures that need no TEXTURE statement and their kinds, and their other names.
BUILT_IN = {"t-tijolo": "brick", "t-listra": "stripes", "t-fractal": "fractal"}
ALIASES = {"t-brick": "t-tijolo", "t-stripes": "t-listra", "t-listras": "t-listra"}
