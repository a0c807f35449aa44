"""Makes the page with the results of ``prosim compare``, one HTML file that needs no other files."""

import base64
import os
import platform
from importlib.resources import files

import drjit as dr
import numpy as np

from ..engine import environment
from ..scene.images import png
from .comparison import LIGHT, Comparison

#: Map of a row -> the percentile that is white in all maps of this kind; a few pixels do not make the rest dark.
WHITE = {"flip": 99.5, "counts": 100.0}


def html(comparison: Comparison, scene: str) -> str:
    """Returns the HTML text of the page for the results of a comparison on a scene called ``scene``. The numbers of the
    page are elements ``<data value=...>`` with the full precision.
    """
    import jinja2

    env = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    template = env.from_string(files(__package__).joinpath("comparison_page.html").read_text(encoding="utf-8"))
    maps = {kind: [getattr(row, kind) for row in comparison.rows] for kind in WHITE}
    scales = {kind: max(float(np.percentile(one, WHITE[kind])) for one in maps[kind]) or 1.0 for kind in WHITE}
    machine = {
        **environment.this_environment(),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "threads": dr.thread_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }
    facts = {"scene": scene, "light": LIGHT[comparison.transport], "machine": machine, "scales": scales}
    return template.render(facts, c=comparison, png=data_uri, rounded=rounded)


def rounded(value: float, digits: int) -> str:
    """Returns a number with so many digits, without an exponent."""
    return np.format_float_positional(value, digits, fractional=False, trim="-")


def data_uri(image: np.ndarray) -> str:
    """Returns the data URI of an image, or of a map as a grey image, as a PNG file."""
    colours = image if image.ndim == 3 else np.repeat(np.float32(image)[..., None], 3, axis=2)
    return "data:image/png;base64," + base64.b64encode(png(colours)).decode()
