"""Makes the page with the results of ``prosim compare``, one HTML file that needs no other files."""

import base64
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from ..scene.images import png
from .comparison import LIGHT


def html(facts: Mapping[str, Any], images: Mapping[str, np.ndarray]) -> str:
    """Returns the HTML text of the page for the results of a :class:`.Comparison`. The numbers of the page are elements
    ``<data value=...>`` with the full precision.
    """
    import jinja2

    env = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    env.globals.update(number=number, light=LIGHT[facts["transport"]])
    template = env.from_string(files(__package__).joinpath("comparison_page.html").read_text(encoding="utf-8"))
    return template.render(facts=facts, pictures={name: picture(facts, name, image) for name, image in images.items()})


def number(value: float | None, form: str = ".3g") -> str:
    """Returns a number in the Python format ``form``, without an exponent, as an element ``<data>``; "–" for None."""
    import markupsafe

    if value is None:
        return "–"
    text = f"{value:{form}}"
    if "e" in text:  # such as 1.2e+02
        text = np.format_float_positional(float(text), trim="-")
    return markupsafe.Markup('<data value="{}">{}</data>').format(repr(value), text)


def picture(facts: Mapping[str, Any], name: str, image: np.ndarray) -> str:
    """Returns the data URI of an image as a PNG file; of a map as a grey image with the scale of its kind."""
    if image.ndim == 2:
        white = facts["scales"][name.rpartition("/")[2]]
        image = np.repeat(np.float32(image / white)[..., None], 3, axis=2)
    return "data:image/png;base64," + base64.b64encode(png(image)).decode()
