"""The meanings of words, for an editor."""

from .language.words import INDICES, Flags, Word

#: (role, name of the model) -> the meaning; see docs/language.md.
MEANINGS = {
    ("DEFAULT", "defaults"): "The default value of a $name; write it above the first use of the name.",
    ("NAME", "name"): "The name of the scene. The file name gives the names of the images.",
    ("SETTING", "channels"): "The channels R, G and B that are written; the others are black. Default: all.",
    ("SETTING", "max_level"): "Deepest level of reflected and refracted rays; 0: camera rays only. Default: 3.",
    ("SETTING", "samples"): "N: the initial samples per pixel; adaptive sampling takes up to N². Default: 5.",
    ("SETTING", "shadows"): "Whether shadow rays are cast. Default: TRUE.",
    ("SETTING", "caustics"): "Whether glass and mirrors cast light on matt surfaces. Default: FALSE.",
    ("SETTING", "air_index"): "Index of refraction outside every object. Default: 1.",
    ("SETTING", "ambient"): "Ambient intensity; a surface adds ka times it. 65535 is 1.0. Default: 0 0 0.",
    ("LIGHTS", "lights"): "The sources: AREA and POINT, each with its parameters. The camera does not see them.",
    ("BACKGROUND", "background"): "Radiance of a ray that leaves the scene, 65535 being 1.0; or a latitude-longitude "
    "image. It lights nothing. Default: 0 0 0.",
    ("VIEW", "view"): "The camera: RESOLUTION, WINDOW, OBS, VPN, VRP and VUP.",
    ("SOLID", "solids"): "A named tree; other trees use it like a primitive, with an index.",
    ("CSG_TREE", "csg"): "The solids, operators before their operands: - CUBE 1 SPHERE 2. Parentheses are comments.",
    ("SURFACE", "surfaces"): "Optics of the primitives with this index.",
    ("TRANSFORM", "transforms"): "The place of the primitives with this index: steps, applied in the order written.",
    ("TEXTURE", "patterns"): "Changes a texture, or defines a new one; its name begins with t-.",
    ("END", ""): "The end of the scene; required. The text after it is ignored.",
    ("LIGHT", "area"): "A source that is a sphere, of radius raio. It needs a position.",
    ("LIGHT", "point"): "A source that is a point. It needs a position.",
    ("LIGHT", "sky"): "Light from all directions: a latitude-longitude image; its 1.0 is 65535.",
    ("LIGHT_PARAMETER", "position"): "The position of the source.",
    (
        "LIGHT_PARAMETER",
        "intensity",
    ): "The brightness of the source; 65535 is 1.0, in the unit of --light-units. Default: 65535 65535 65535.",
    ("LIGHT_PARAMETER", "radius"): "Radius of the sphere; of a POINT the virtual one. Default: 1.",
    ("LIGHT_PARAMETER", "direction"): "The axis of a CONE or SPOT. Default: 0 -1 0.",
    ("LIGHT_PARAMETER", "angle"): "Half-opening of a CONE (default 30), cut-off of a SPOT, from the axis.",
    ("LIGHT_PARAMETER", "exponent"): "A SPOT emits with cosⁿ of the angle to its direction. Default: 1.",
    ("DISTRIBUTION", "uniform"): "Emits equally in all directions; the default.",
    ("DISTRIBUTION", "cone"): "Emits within angle of direction.",
    ("DISTRIBUTION", "spot"): "Emits with cosⁿ of the angle to direction; n is exponent.",
    ("VIEW_PARAMETER", "resolution"): "Size of the image. Default: 500 500.",
    ("VIEW_PARAMETER", "window"): "The visible part of the view plane, relative to VRP. Default: -10 -10 10 10.",
    ("VIEW_PARAMETER", "eye"): "The eye. Default: 0 0 20.",
    ("VIEW_PARAMETER", "vpn"): "Normal of the view plane; 0 0 0, the default, is OBS - VRP.",
    ("VIEW_PARAMETER", "vrp"): "The reference point, on the view plane. Default: 0 0 0.",
    ("VIEW_PARAMETER", "vup"): "The upward direction of the image. Default: 0 1 0.",
    ("PRIMITIVE", "cube"): "The solid [0, 1]³. Its index names its SURFACE and its TRANSFORM; textures may follow.",
    ("PRIMITIVE", "sphere"): "The unit ball at the origin. Its index names its SURFACE and its TRANSFORM.",
    ("PRIMITIVE", "cylinder"): "x² + y² ≤ 1, 0 ≤ z ≤ 1. Its index names its SURFACE and its TRANSFORM.",
    ("PRIMITIVE", "cone"): "x² + y² ≤ z², 0 ≤ z ≤ 1, its apex at the origin. Its index names SURFACE and TRANSFORM.",
    ("PRIMITIVE", "mesh"): "A closed mesh from a file, PLY or OBJ, which follows the index, as in MESH 1 vaso.ply.",
    ("MATERIAL", "material"): "Its kind: condutor, dieletrico, lambertiano or composto; none is classic Phong.",
    ("CONDUCTOR", "conductor"): "A metal: n-refr and k-abs, or its name; smooth, or rough by n, rug or m.",
    ("DIELECTRIC", "dielectric"): "Glass and the like: n-refr, or a glass's name; smooth, or rough by n, rug or m.",
    ("MATERIAL_KIND", "lambertian"): "A matt surface: kd.",
    ("MATERIAL_KIND", "composite"): "A matt surface under a glossy coat: kd, ks, n-refr; smooth, or rough by n or m.",
    ("METAL", "metal"): "A metal by its name, such as ouro, or a table of Mitsuba's, such as Cu_palik.",
    ("OPTIC", "ka"): "Factor of the ambient intensity. Default: kd; 0 for condutor and dieletrico.",
    ("OPTIC", "kd"): "Diffuse reflectance, 0 to 1. Default: 0.5 0.5 0.5.",
    ("OPTIC", "ks"): "Specular reflectance, 0 to 1. Default: 0 on a Phong surface, 1 - kd of a composto.",
    ("OPTIC", "eta"): "Index of refraction.",
    ("OPTIC", "k"): "Coefficient of absorption of a metal.",
    ("OPTIC", "abbe"): "Abbe number of a dieletrico, whose n-refr is then that at 587.6 nm: how it disperses light.",
    ("OPTIC", "transmittance"): "Fraction of the light that remains after the distance espessura inside a dieletrico.",
    ("OPTIC", "thickness"): "The distance of transmitancia. Default: 1.",
    ("OPTIC", "exponent"): "Roughness as a Phong exponent: larger is smoother. None: ideally smooth.",
    ("OPTIC", "slope"): "Roughness as the RMS slope of Beckmann's distribution: larger is rougher.",
    ("STEP", "scale"): "Factors along the axes; negative ones mirror.",
    ("STEP", "rotate-x"): "A rotation about the x axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "rotate-y"): "A rotation about the y axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "rotate-z"): "A rotation about the z axis, in degrees, counter-clockwise seen from its tip.",
    ("STEP", "translate"): "A translation.",
    ("KIND", "brick"): "Bricks and their joints.",
    ("KIND", "stripes"): "Stripes of two colours.",
    ("KIND", "fractal"): "Fractal noise between two colours.",
    ("PARAMETER", "brick"): "Colour of the bricks, a factor of ka and kd. Default: 1 .7 .6.",
    ("PARAMETER", "mortar"): "Colour of the joints, a factor of ka and kd. Default: 1.4 1.5 1.8.",
    ("PARAMETER", "brick_width"): "Width of a brick without its joint. Default: .0793.",
    ("PARAMETER", "brick_height"): "Height of a brick without its joint. Default: .0345.",
    ("PARAMETER", "mortar_width"): "Width of the joints. Default: .004.",
    ("PARAMETER", "stagger"): "Offset of every second row, in bricks. Default: .5.",
    ("PARAMETER", "color0"): "The first colour, a factor of ka and kd. Default: 1 1 1 (stripes), .5 .5 .5 (fractal).",
    ("PARAMETER", "color1"): "The second colour, a factor of ka and kd. Default: .35 .35 .35, 1.2 1.2 1.2 (fractal).",
    ("PARAMETER", "frequency"): "Pairs of stripes per unit. Default: 6.",
    ("PARAMETER", "duty"): "Fraction of the first colour in a pair. Default: .5.",
    ("PARAMETER", "axis"): "The direction across the stripes. Default: 0 1 0 in the first slot, 0 0 1 in the second.",
    ("PARAMETER", "scale"): "Frequency of the coarsest noise. Default: 4.",
    ("PARAMETER", "octaves"): "Number of frequencies. Default: 6.",
    ("PARAMETER", "gain"): "Amplitude of each frequency relative to the one before. Default: .5.",
    ("PARAMETER", "lacunarity"): "Each frequency relative to the one before. Default: 2.",
    ("PARAMETER", "seed"): "The seed of the noise. Default: 0.",
    ("BOOL", "true"): "Yes; 1 means the same.",
    ("BOOL", "false"): "No; 0 means the same.",
    ("NULL", ""): "No texture, or no image.",
}
OPERATORS = {
    "PLUS": "`+` A B: the union of two solids.",
    "MINUS": "`-` A B: the difference of two solids.",
    "TIMES": "`*` A B: the intersection of two solids.",
}


def takes(word: Word) -> str:
    """The values after a word: ``x y z``, or nothing."""
    return " ".join(["TRUE"] * word.takes.count) if isinstance(word.takes, Flags) else word.takes.what


def of_word(word: Word) -> str:
    """A word's meaning, its values with their units and range, and its other spellings, as Markdown."""
    lines = [f"**{word.canonical}** {takes(word)}".rstrip(), MEANINGS[word.role, word.name]]
    if word.takes.count and not isinstance(word.takes, Flags):
        each = "each " if word.takes.count > 1 else ""
        lines.append(f"{word.takes.what}: {each}{word.takes.bounds()}")
    if word.of:
        lines.append("Of: " + ", ".join(word.of))
    if len(word.spellings) > 1:
        lines.append("Also: " + ", ".join(word.spellings[1:]))
    return "\n\n".join(lines)


def of_name(what: str, names: dict[str, str], name: str) -> str:
    """The table or the material behind the name of a metal or a glass, and its other names, as Markdown."""
    if name not in names:
        return f"no {what} has this name"
    index = f": n-refr = {INDICES[names[name]]} at 587.6 nm" if what == "glass" else ""
    return (
        f"The {what} **{names[name]}**{index}\n\nNames: {', '.join(one for one in names if names[one] == names[name])}"
    )
