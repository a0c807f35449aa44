"""The page of ``prosim compare``: one HTML file without links, and its numbers as JSON."""

import base64
import io
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from .measures import display

#: The results of a comparison: texts and numbers, fit for JSON.
Facts = Mapping[str, Any]

#: Measure -> (heading, explanation).
MEASURES = {
    "rmse": ("RMSE", "root mean square error of the linear image"),
    "tone_mapped_rmse": ("tone-mapped RMSE", "the same after a square root, about what a screen shows"),
    "percentile99": ("99th percentile", "error that all but one pixel in a hundred stay below, tone-mapped"),
    "relative_mse": ("relMSE", "squared error over the squared reference plus 0.01"),
    "ssim": ("SSIM", "structural similarity; 1 is equal"),
    "flip": ("ꟻLIP", "difference that a viewer sees when flipping between the two; 0 is none"),
}

TRANSPORTS = {
    "paths": "the same light: every path",
    "direct": "the same light: that of the sources alone",
    "scene": "the light that the scene asks for",
}


def html(facts: Facts, images: Mapping[str, np.ndarray]) -> str:
    """The page as text. Each number on it stands in ``facts`` too, as ``<data value=...>`` gives it in full."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.globals.update(
        number=number, picture=picture, described=described, MEASURES=MEASURES, TRANSPORTS=TRANSPORTS
    )
    template = environment.from_string(files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    return template.render(
        facts=facts, pictures=encode(facts, images), charts=[chart(section) for section in facts["sections"]]
    )


def described(role: str) -> str:
    """What a row of the table is, beside its name."""
    kind = {"a": "as the scene has it", "b": "as the scene has it", "b at equal samples": "equal samples"}
    plain = role.removesuffix(" denoised")
    return kind.get(plain, "equal time") + (", denoised" if plain != role else "")


def number(value: float | None, form: str = ".3g", unit: str = "") -> str:
    """A number as it stands on the page."""
    import markupsafe

    if value is None:
        return "–"
    # No exponents: 0.0000123 reads better beside its like, and 1.2e+02 is no way to write 120.
    text = f"{value:{form}}"
    if "e" in text:
        text = np.format_float_positional(float(text), trim="-")
    return markupsafe.Markup('<data value="{}">{}</data>{}').format(repr(value), text, unit)


def picture(source: str, caption: str, classes: str = "") -> str:
    """An image that is opened and closed by a click."""
    import markupsafe

    return markupsafe.Markup('<figure class="{}"><img src="{}" alt="{}"><figcaption>{}</figcaption></figure>').format(
        classes, source, caption, caption
    )


def data_uri(content: bytes, kind: str) -> str:
    """``content``, an image of that kind, as a URI."""
    return f"data:image/{kind};base64," + base64.b64encode(content).decode()


def png(image: np.ndarray) -> str:
    """``image``, of shape (height, width, 3) in [0, 1], as a PNG data URI."""
    from matplotlib.image import imsave

    file = io.BytesIO()
    imsave(file, np.ascontiguousarray(np.clip(image, 0, 1)), format="png")
    return data_uri(file.getvalue(), "png")


def coloured(values: np.ndarray, top: float, name: str = "magma") -> np.ndarray:
    """Numbers as colours, from 0 to ``top``."""
    from matplotlib import colormaps

    return colormaps[name](np.clip(values / top, 0, 1))[..., :3]


def encode(facts: Facts, images: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Images as data URIs; maps of one kind share their scale."""
    colours = {"error": "magma", "flip": "magma", "counts": "viridis"}
    result = {}
    for name, image in images.items():
        kind = name.rpartition("/")[2]
        if kind in colours:
            result[name] = png(coloured(image, facts["scales"][kind], colours[kind]))
        elif kind == "signed":
            shown = np.mean(np.sign(image) * display(np.abs(image)), axis=2)
            result[name] = png(coloured(shown + 1, 2, "RdBu_r"))
        else:
            result[name] = png(display(image))
    return result


def chart(section: Facts) -> str:
    """Curves of a section, as an SVG data URI."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(10.5, 6.6), layout="constrained")
    axes = figure.subplots(2, 2, sharey="row")
    for row, measure in zip(axes, ("rmse", "flip")):
        for axis, (cost, label) in zip(
            row, (("samples", "samples per pixel"), ("cpu", "processor seconds per thread"))
        ):
            for curve, colour in zip(section["curves"], ("#c2410c", "#1d4ed8")):
                axis.loglog(
                    [p[cost] for p in curve["points"]],
                    [max(p[measure], 1e-7) for p in curve["points"]],
                    "o-",
                    color=colour,
                    label=curve["name"],
                )
            for entry in section["rows"]:
                colour = "#c2410c" if entry["role"][0] == "a" else "#1d4ed8"
                x = entry[cost] if cost == "samples" else entry[cost]["median"]
                axis.loglog(
                    [x], [max(entry[measure]["median"], 1e-7)], "D", color=colour, markersize=9, markerfacecolor="none"
                )
            axis.set_xlabel(label)
            axis.grid(True, which="both", alpha=0.2)
            for side in (axis.xaxis, axis.yaxis):
                side.set_major_locator(LogLocator(subs=(1, 2, 5)))
                side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.12g}"))
                side.set_minor_formatter(NullFormatter())
        row[0].set_ylabel(MEASURES[measure][0])
    axes[0, 0].legend()
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "path"}):
        figure.savefig(file, format="svg")
    return data_uri(file.getvalue(), "svg+xml")


def json_text(facts: Facts) -> str:
    """All facts, each number in full."""
    return json.dumps(facts, indent=1, ensure_ascii=False) + "\n"
