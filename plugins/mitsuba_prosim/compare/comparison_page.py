"""Makes the page with the results of ``prosim compare``, one HTML file that needs no other files, and a JSON file."""

import base64
import io
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from ..scene.images import png
from .comparison import COLOUR_MAPS, LIGHT, median

#: The results of a comparison: texts and numbers that can be written as JSON.
Facts = Mapping[str, Any]

#: Measure -> (heading, explanation).
MEASURES = {
    "rmse": ("RMSE", "root mean square error of the linear image"),
    "tone_mapped_rmse": ("tone-mapped RMSE", "RMSE after a square root, which is about what a screen shows"),
    "percentile99": ("99th percentile", "tone-mapped error that 99 % of the pixels do not exceed"),
    "relative_mse": ("relMSE", "squared error over the squared reference plus 0.01"),
    "flip": ("ꟻLIP", "difference that a viewer sees when flipping between image and reference; 0 is none"),
}

#: Method -> its colour in the charts.
COLOURS = {"a": "#c2410c", "b": "#1d4ed8"}


def html(facts: Facts, images: Mapping[str, np.ndarray]) -> str:
    """Returns the HTML text of the page, whose numbers are elements ``<data value=...>`` with the full precision."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.globals.update(number=number, described=described, MEASURES=MEASURES, LIGHT=LIGHT)
    template = environment.from_string(files(__package__).joinpath("comparison_page.html").read_text(encoding="utf-8"))
    return template.render(
        facts=facts, pictures=encode(facts, images), charts=[chart(section) for section in facts["sections"]]
    )


def described(role: str) -> str:
    """Returns the role of a table row in words, such as "equal time, denoised" for "b at equal time denoised"."""
    kind = "equal samples" if "samples" in role else "equal time" if "time" in role else "as in the scene"
    return kind + (", denoised" if role.endswith(" denoised") else "")


def number(value: float | None, form: str = ".3g") -> str:
    """Returns a number in the Python format ``form``, without an exponent, as an element ``<data>``; "–" for None."""
    import markupsafe

    if value is None:
        return "–"
    text = f"{value:{form}}"
    if "e" in text:  # such as 1.2e+02
        text = np.format_float_positional(float(text), trim="-")
    return markupsafe.Markup('<data value="{}">{}</data>').format(repr(value), text)


def data_uri(file: io.BytesIO, kind: str) -> str:
    """Returns the content of ``file``, an image in the format ``kind``, as a data URI."""
    return f"data:image/{kind};base64," + base64.b64encode(file.getvalue()).decode()


def encode(facts: Facts, images: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Returns the data URI of each image as a PNG file: maps with the colour scale of their kind, others in sRGB."""
    from matplotlib.image import imsave

    result = {}
    for name, image in images.items():
        kind, file = name.rpartition("/")[2], io.BytesIO()
        if kind in COLOUR_MAPS:
            imsave(file, image, format="png", cmap=COLOUR_MAPS[kind], vmin=0, vmax=facts["scales"][kind])
        else:
            file.write(png(image))
        result[name] = data_uri(file, "png")
    return result


def chart(section: Facts) -> str:
    """Returns the curves of error against cost of a section, with diamonds for the rows, as the data URI of an SVG
    image.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 6.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    costs = {"samples": "samples per pixel", "cpu": "processor seconds per thread"}
    for line, measure in zip(axes, ("rmse", "flip")):
        for axis, cost in zip(line, costs):
            for curve in section["curves"]:
                points = [(median(point, cost), median(point, measure)) for point in curve["points"]]
                axis.loglog(*zip(*points), "o-", color=COLOURS[curve["role"]], label=curve["name"])
            for row in section["rows"]:
                colour = COLOURS[row["role"][0]]
                axis.loglog(median(row, cost), median(row, measure), "D", color=colour, ms=9, markerfacecolor="none")
            axis.grid(True, which="both", alpha=0.2)
        line[0].set_ylabel(MEASURES[measure][0])
    for axis, label in zip(axes[1], costs.values()):
        axis.set_xlabel(label)
    axes[0, 0].legend()
    file = io.BytesIO()
    figure.savefig(file, format="svg")
    return data_uri(file, "svg+xml")
