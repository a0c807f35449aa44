"""What an editor shows where the pointer rests: the meanings of words, and what is known of the metals."""

from dataclasses import dataclass

from .language.words import METALS, Flags, Numbers, Word

#: (role, name of the model) -> the meaning; see docs/language.md.
MEANINGS = {
    ("DEFAULT", "defaults"): "The value of a $name where nothing from without gives one; stands above its first use.",
    ("NAME", "name"): "The scene's name. Images are called after the file.",
    ("SETTING", "channels"): "Which of R, G and B are written; the others are black. Default: all.",
    ("SETTING", "max_level"): "Deepest level of reflected and refracted rays; 0: what is seen directly. Default: 3.",
    ("SETTING", "samples"): "N: the initial samples a pixel; adaptive sampling takes up to N². Default: 5.",
    ("SETTING", "shadows"): "Whether shadow rays are cast. Default: TRUE.",
    ("SETTING", "caustics"): "Whether light is followed through glass and by mirrors to matt surfaces. Default: FALSE.",
    ("SETTING", "air_index"): "Index of refraction outside every object. Default: 1.",
    ("SETTING", "ambient"): "Ambient intensity; a surface adds ka times it. 65535 is 1.0. Default: 0 0 0.",
    ("LIGHTS", "lights"): "The sources: AREA and POINT, each with its parameters. The camera does not see them.",
    ("BACKGROUND", "background"): "Radiance of a ray that leaves the scene, 65535 being 1.0; or a latitude-longitude "
    "image. It lights nothing. Default: 0 0 0.",
    ("VIEW", "view"): "The camera: RESOLUTION, WINDOW, OBS, VPN, VRP and VUP.",
    ("SOLID", "solids"): "A tree with a name, which stands in other trees like a primitive, with an index.",
    ("CSG_TREE", "csg"): "The solids, operators before their operands: - CUBE 1 SPHERE 2. Parentheses are remarks.",
    ("SURFACE", "surfaces"): "Optics of the primitives with this index.",
    ("TRANSFORM", "transforms"): "Where the primitives with this index are: steps, applied in the order written.",
    ("TEXTURE", "patterns"): "Changes a texture, or makes another, whose name begins with t-.",
    ("END", ""): "The end of the scene; required. What follows is ignored.",
    ("LIGHT", "area"): "A source that is a sphere, of radius raio. It needs a position.",
    ("LIGHT", "point"): "A source that is a point. It needs a position.",
    ("LIGHT", "sky"): "Light from all around: an image, latitude by longitude, 1.0 being 65535.",
    ("LIGHT_PARAMETER", "position"): "Where the source is.",
    ("LIGHT_PARAMETER", "intensity"): "How bright the source is; 65535 is 1.0, what that means says --light-units. "
    "Default: 65535 65535 65535.",
    ("LIGHT_PARAMETER", "radius"): "Radius of the sphere; of a POINT the virtual one. Default: 1.",
    ("LIGHT_PARAMETER", "direction"): "The axis of a CONE or SPOT. Default: 0 -1 0.",
    ("LIGHT_PARAMETER", "angle"): "Half-opening of a CONE (default 30), cut-off of a SPOT, from the axis.",
    ("LIGHT_PARAMETER", "exponent"): "A SPOT shines with cosⁿ of the angle to its direction. Default: 1.",
    ("DISTRIBUTION", "uniform"): "Shines alike in all directions; the default.",
    ("DISTRIBUTION", "cone"): "Shines within angle of direction.",
    ("DISTRIBUTION", "spot"): "Shines with cosⁿ of the angle to direction, n being exponent.",
    ("VIEW_PARAMETER", "resolution"): "Size of the image. Default: 500 500.",
    ("VIEW_PARAMETER", "window"): "What is seen of the view plane, relative to VRP. Default: -10 -10 10 10.",
    ("VIEW_PARAMETER", "eye"): "The eye. Default: 0 0 20.",
    ("VIEW_PARAMETER", "vpn"): "Normal of the view plane; 0 0 0, the default, is OBS - VRP.",
    ("VRP", "vrp"): "The reference point, on the view plane. Default: 0 0 0.",
    ("VIEW_PARAMETER", "vup"): "What points up in the image. Default: 0 1 0.",
    ("PRIMITIVE", "cube"): "The solid [0, 1]³. Its index names its SURFACE and its TRANSFORM; textures may follow.",
    ("PRIMITIVE", "sphere"): "The unit ball at the origin. Its index names its SURFACE and its TRANSFORM.",
    ("PRIMITIVE", "cylinder"): "x² + y² ≤ 1, 0 ≤ z ≤ 1. Its index names its SURFACE and its TRANSFORM.",
    ("PRIMITIVE", "cone"): "x² + y² ≤ z², 0 ≤ z ≤ 1, its apex at the origin. Its index names SURFACE and TRANSFORM.",
    ("PRIMITIVE", "mesh"): "A closed mesh from a file, PLY or OBJ, which follows the index, as in MESH 1 vaso.ply.",
    ("MATERIAL", "material"): "Its kind: condutor, dieletrico, lambertiano or composto; none is classic Phong.",
    ("CONDUCTOR", "conductor"): "A metal: n-refr and k-abs, or its name; smooth, or rough by n, rug or m.",
    ("DIELECTRIC", "dielectric"): "Glass and the like: n-refr, or a glass's name; smooth, or rough by n, rug or m.",
    ("MATERIAL_KIND", "lambertian"): "A matt surface: kd.",
    (
        "MATERIAL_KIND",
        "composite",
    ): "A matt surface under a glossy one: kd, ks, n-refr; smooth, or rough by n, rug or m.",
    ("METAL", "metal"): "A metal by its name, such as ouro, or a table of Mitsuba's, such as Cu_palik.",
    ("OPTIC", "ka"): "Factor of the ambient intensity. Default: kd; 0 for condutor and dieletrico.",
    ("OPTIC", "kd"): "Diffuse reflectance, 0 to 1. Default: 0.5 0.5 0.5.",
    ("OPTIC", "ks"): "Specular reflectance, 0 to 1. Default: 0 on a Phong surface, 1 - kd of a composto.",
    ("OPTIC", "eta"): "Index of refraction.",
    ("OPTIC", "k"): "Coefficient of absorption of a metal.",
    ("OPTIC", "abbe"): "Abbe number of a dieletrico, whose n-refr is then that at 587.6 nm: how it disperses light.",
    ("OPTIC", "transmittance"): "Share of the light that is left after a way of espessura through a dieletrico.",
    ("OPTIC", "thickness"): "The way after which transmitancia is left. Default: 1.",
    ("OPTIC", "exponent"): "Roughness as a Phong exponent: larger is smoother. None: ideally smooth.",
    ("OPTIC", "slope"): "Roughness as the RMS slope of Beckmann's distribution: larger is rougher.",
    ("STEP", "scale"): "Factors along the axes; negative ones mirror.",
    ("STEP", "rotate-x"): "A turn about the x axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "rotate-y"): "A turn about the y axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "rotate-z"): "A turn about the z axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "translate"): "A move.",
    ("KIND", "brick"): "Bricks and their joints.",
    ("KIND", "stripes"): "Stripes of two colours.",
    ("KIND", "fractal"): "Fractal noise between two colours.",
    ("PARAMETER", "brick"): "Colour of the bricks, a factor of ka and kd. Default: 1 .7 .6.",
    ("PARAMETER", "mortar"): "Colour of the joints, a factor of ka and kd. Default: 1.4 1.5 1.8.",
    ("PARAMETER", "brick_width"): "Width of a brick without its joint. Default: .0793.",
    ("PARAMETER", "brick_height"): "Height of a brick without its joint. Default: .0345.",
    ("PARAMETER", "mortar_width"): "Width of the joints. Default: .004.",
    ("PARAMETER", "stagger"): "How far every second row is moved, in bricks. Default: .5.",
    ("PARAMETER", "color0"): "The first colour, a factor of ka and kd. Default: 1 1 1 (stripes), .5 .5 .5 (fractal).",
    ("PARAMETER", "color1"): "The second colour, a factor of ka and kd. Default: .35 .35 .35, 1.2 1.2 1.2 (fractal).",
    ("PARAMETER", "frequency"): "Pairs of stripes a unit. Default: 6.",
    ("PARAMETER", "duty"): "Share of the first colour in a pair. Default: .5.",
    ("PARAMETER", "axis"): "Across the stripes. Default: 0 1 0 in the first slot, 0 0 1 in the second.",
    ("PARAMETER", "scale"): "Frequency of the coarsest noise. Default: 4.",
    ("PARAMETER", "octaves"): "How many frequencies there are. Default: 6.",
    ("PARAMETER", "gain"): "How strong each frequency is against the one before. Default: .5.",
    ("PARAMETER", "lacunarity"): "How much higher each frequency is than the one before. Default: 2.",
    ("PARAMETER", "seed"): "Which noise it is. Default: 0.",
    ("BOOL", "true"): "Yes; 1 means the same.",
    ("BOOL", "false"): "No; 0 means the same.",
    ("NULL", ""): "No texture, or no image.",
}
OPERATORS = {
    "PLUS": "`+` A B: the union of two solids.",
    "MINUS": "`-` A B: the first solid without the second.",
    "TIMES": "`*` A B: what two solids have in common.",
}
TEXTURES = {"brick": "Bricks.", "stripes": "Stripes.", "fractal": "Fractal noise."}


def takes(word: Word) -> str:
    """What follows a word: ``x y z``, or nothing."""
    if isinstance(word.takes, Flags):
        return " ".join(["TRUE"] * word.takes.count)
    if isinstance(word.takes, Numbers):
        return word.takes.what
    return ""


def of_word(word: Word) -> str:
    """A word's meaning, what follows it, in which units and range, and its other spellings, as Markdown."""
    lines = [f"**{word.canonical}** {takes(word)}".rstrip(), MEANINGS[word.role, word.name]]
    if isinstance(word.takes, Numbers):
        each = "each " if word.takes.count > 1 else ""
        lines.append(f"{word.takes.what}: {each}{word.takes.bounds()}")
    if word.of:
        lines.append("Of: " + ", ".join(word.of))
    if len(word.spellings) > 1:
        lines.append("Also: " + ", ".join(word.spellings[1:]))
    return "\n\n".join(lines)


#: Where the tables of the metals are from.
FIRST = "Palik (ed.), Handbook of Optical Constants of Solids, 1985"
SECOND = "Palik (ed.), Handbook of Optical Constants of Solids II, 1991"
JOINED = "Palik's handbook, joined to X-ray tables (LLNL, CXRO)"
UNNAMED = "luxpop.com, which names no source"
TINGES = {"red": "reddish", "yellow": "yellowish", "blue": "bluish", "violet": "violet"}


@dataclass(frozen=True)
class Measured:
    """A table of Mitsuba's: its ``source``, as the table itself says, and the wavelengths in nm at which it begins and
    ends. ``n`` and ``k`` are those at 589.3 nm, the sodium lines; ``rgb`` is what it reflects of white light (D65) that
    falls straight on it, in linear sRGB.
    """

    source: str
    begins: int
    ends: int
    n: float
    k: float
    rgb: tuple[float, float, float]


MEASURED = {
    "Ag": Measured(UNNAMED, 299, 886, 0.121, 3.65, (0.97, 0.96, 0.92)),
    "Al": Measured(UNNAMED, 299, 886, 1.14, 7.14, (0.91, 0.92, 0.92)),
    "Au": Measured(UNNAMED, 299, 886, 0.239, 2.97, (1.02, 0.78, 0.34)),
    "Be_palik": Measured(UNNAMED, 310, 886, 3.42, 3.17, (0.54, 0.54, 0.54)),
    "Cr": Measured(JOINED, 300, 886, 3.38, 4.37, (0.63, 0.66, 0.70)),
    "Cu": Measured(UNNAMED, 302, 886, 0.482, 2.8, (0.96, 0.64, 0.54)),
    "Cu_palik": Measured(FIRST, 310, 827, 0.482, 2.8, (0.95, 0.64, 0.54)),
    "Hg": Measured(JOINED, 310, 886, 1.75, 4.93, (0.78, 0.78, 0.78)),
    "Hg_palik": Measured(SECOND, 310, 886, 1.75, 4.93, (0.78, 0.78, 0.78)),
    "Ir": Measured(JOINED, 302, 886, 2.4, 4.48, (0.70, 0.69, 0.66)),
    "Ir_palik": Measured(FIRST, 302, 886, 2.4, 4.48, (0.70, 0.69, 0.66)),
    "K": Measured(SECOND, 305, 861, 0.0523, 1.59, (0.95, 0.94, 0.92)),
    "K_palik": Measured(SECOND, 305, 861, 0.0523, 1.59, (0.95, 0.94, 0.92)),
    "Li": Measured(SECOND, 306, 751, 0.213, 2.69, (0.92, 0.89, 0.81)),
    "Li_palik": Measured(SECOND, 306, 751, 0.213, 2.69, (0.92, 0.89, 0.81)),
    "Mo": Measured(JOINED, 302, 886, 3.68, 3.45, (0.56, 0.58, 0.57)),
    "Mo_palik": Measured(FIRST, 302, 886, 3.68, 3.45, (0.56, 0.58, 0.57)),
    "Na_palik": Measured(SECOND, 312, 861, 0.0541, 2.43, (0.98, 0.96, 0.94)),
    "Nb": Measured(JOINED, 310, 855, 2.91, 2.87, (0.50, 0.51, 0.50)),
    "Nb_palik": Measured(SECOND, 310, 855, 2.91, 2.87, (0.50, 0.51, 0.50)),
    "Ni_palik": Measured(FIRST, 302, 886, 1.85, 3.47, (0.66, 0.61, 0.53)),
    "Rh": Measured(JOINED, 302, 886, 2.05, 5.29, (0.80, 0.76, 0.74)),
    "Rh_palik": Measured(FIRST, 302, 886, 2.05, 5.29, (0.80, 0.76, 0.74)),
    "Ta": Measured(JOINED, 310, 886, 2.11, 1.84, (0.39, 0.36, 0.41)),
    "Ta_palik": Measured(SECOND, 310, 886, 2.11, 1.84, (0.39, 0.36, 0.41)),
    "V_palik": Measured(SECOND, 302, 886, 3.65, 2.94, (0.51, 0.53, 0.57)),
    "W": Measured(JOINED, 302, 886, 3.54, 2.84, (0.52, 0.50, 0.47)),
}


def of_metal(name: str) -> str:
    """The metal of a name, as Markdown."""
    table = METALS[name]
    one = MEASURED[table]
    element = table.partition("_")[0]
    names = [other for other, its in METALS.items() if its == table]
    called = next(other for other, its in METALS.items() if its.partition("_")[0] == element)
    rgb = " ".join(f"{value:.2f}" for value in one.rgb)
    lines = [
        f"**{called}**, the table {table}",
        f"{colour(one.rgb).capitalize()}: of white light that falls straight on it reflects {rgb} (red, green, blue)",
        f"n = {one.n:g} and k = {one.k:g} at 589.3 nm; measured from {one.begins} to {one.ends} nm",
        f"From: {one.source}",
        "Also: " + ", ".join(other for other in names if other != name),
    ]
    return "\n\n".join(lines if len(names) > 1 else lines[:-1])


def colour(rgb: tuple[float, float, float]) -> str:
    """The colour of a metal in words, such as "yellow" or "bluish grey"."""
    low, high = min(rgb), max(rgb)
    grey = "white" if high >= 0.85 else "light grey" if high >= 0.7 else "grey" if high >= 0.45 else "dark grey"
    strength = (high - low) / high
    if strength < 0.06:
        return grey
    red, green, blue = rgb
    if blue == high:
        hue = "violet" if red > green else "blue"
    else:
        hue = "yellow" if green - blue > 0.5 * (red - blue) else "red"
    return hue if strength > 0.35 else f"{TINGES[hue]} {grey}"
