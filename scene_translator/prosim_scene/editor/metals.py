"""What is known of the measured metals: where their tables are from, how far they reach, and their colours."""

from dataclasses import dataclass

from ..language.names import METALS

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


def described(name: str) -> str:
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
