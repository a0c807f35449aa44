"""Makes the page that explains a pixel: one HTML file that needs no other files.

The squares of random numbers on the page are the patterns of the thesis (figures 4.7, 5.10 and 5.11).
"""

import base64
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import dr_array, world_matrix
from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..sampling.spaces import DIFFUSE, LENS, NODE_SPACES, PIXEL, REFLECTED, REFRACTED
from .recorder import LIT, Node

#: Number of the brightest samples whose rays are on the page, and their maximum size in characters; maximum number of
#: lamps of a node.
BRIGHTEST, MOST_CHARACTERS, MOST_LAMPS = 8, 1 << 20, 16
#: The Content-Security-Policy of the page: it has no origin, and can load and send nothing.
POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
#: Maximum numbers of samples in a pattern, and of patterns.
MOST_POINTS, MOST_PATTERNS = 256, 128


def html(facts: Mapping[str, Any], trees: Mapping[int, Sequence[Node]], **more: Any) -> str:
    """Returns the HTML text of the page. ``facts`` are those of an explanation, and ``trees`` maps samples to their
    nodes; trees that would make the page too large are left out. ``more``: :attr:`.Explanation.drawing`, and the image.
    """
    stored = [{"sample": k, "nodes": [*map(shown, nodes)]} for k, nodes in trees.items()]
    while len(stored) > 1 and len(json.dumps(stored)) > MOST_CHARACTERS:
        stored.pop()
    data = {"name": "the image", "image": "", "command": "", **facts, "trees": stored, **more}
    data |= dict.fromkeys(("nodes", "drawing"))
    page, script = (
        files(__package__).joinpath(f"explanation_page.{kind}").read_text("utf-8") for kind in ("html", "js")
    )
    return page.replace("SCRIPT", script).replace("DATA", json.dumps(data).replace("<", "\\u003c"))


def shown(node: Node) -> dict[str, Any]:
    """Returns what the page shows of a node: at most :data:`MOST_LAMPS` lamps, and the sum of the others."""
    scattered = [sum(sum(lobe.bsdf) * lobe.weight for lobe in lamp.lobes) for lamp in node.lamps]
    order = sorted(range(len(scattered)), key=lambda k: -scattered[k] * sum(node.lamps[k].weighted_radiance))
    kept, left = sorted(order[:MOST_LAMPS]), order[MOST_LAMPS:]
    others = [*map(sum, zip(*(node.lamps[k].contribution for k in left)))]
    return asdict(replace(node, lamps=tuple(node.lamps[k] for k in kept))) | {"others": others, "left": len(left)}


def picture(image: Any) -> str:
    """Returns an image as the data URI of a JPEG file."""
    bitmap = mi.Bitmap(np.array(image)[..., :3]).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
    stream = mi.MemoryStream()
    bitmap.write(stream, mi.Bitmap.FileFormat.JPEG, 90)
    return "data:image/jpeg;base64," + base64.b64encode(stream.raw_buffer()).decode()


def pinhole(estimator: Estimator) -> dict[str, Any] | None:
    """Returns the data by which the page projects points to the image; None if the rays do not begin at one point."""
    on_film = mi.Point2f([0, 1, 0, 1], [0, 0, 1, 1])  # upper left, upper right, lower left, lower right
    d = np.array(estimator.rays(mi.Float(0), mi.Float(0.5), on_film, mi.Point2f(0.5))[0].d)
    corners, sensor = np.broadcast_to(d, (3, 4)), estimator.sensor  # parallel rays have one direction
    try:
        right, below, first = np.linalg.solve(corners[:, [1, 2, 0]] * (1, 1, -1), corners[:, 3])
    except np.linalg.LinAlgError:
        return None
    origin, film = first * corners[:, 0], sensor.film()
    matrix = np.linalg.inv(np.stack([origin, right * corners[:, 1] - origin, below * corners[:, 2] - origin], axis=1))
    places = {"size": list(map(int, film.size())), "offset": list(map(int, film.crop_offset()))}
    return {"origin": world_matrix(sensor)[:3, 3].tolist(), "matrix": matrix.tolist(), **places}


def patterns(
    estimator: Estimator, plan: Plan, where: tuple[int, int], count: int, trees: Iterable[Sequence[Node]]
) -> list[tuple[int, str, list[int]]]:
    """Returns the pairs of random numbers that the nodes of ``trees`` use: the number of the node, a name, and the
    numbers u, v of each sample, times 1000. ``where`` is the pixel in the whole film, ``count`` its number of samples.
    """
    transport: Any = estimator.transport
    wanted = {(1, PIXEL): "pixel"}
    if estimator.sensor.needs_aperture_sample():
        wanted[1, LENS] = "lens"
    for nodes in trees:
        for number, space, name in node_spaces(transport, nodes):
            wanted[number, int(transport.space(number, space))] = name
    keys, width = list(wanted)[:MOST_PATTERNS], min(count, MOST_POINTS)
    t = dr.tile(dr.arange(mi.UInt32, width), len(keys))
    spaces = dr.repeat(dr_array(np.array([space for _, space in keys], np.uint32)), width)
    x, y = (dr.opaque(mi.Int32, value, len(t)) for value in where)
    points = np.array(plan.points(x, y, t)(spaces))
    numbers = (1000 * points).astype(int).T.reshape(len(keys), -1).tolist()
    return [(key[0], wanted[key], pattern) for key, pattern in zip(keys, numbers)]


def node_spaces(transport: Any, nodes: Sequence[Node]) -> Iterator[tuple[int, int, str]]:
    """Yields the number of a node, a space of this node, and its name, for each pair of random numbers that matters."""
    tree, lamps = transport.settings.follows_tree, transport.lights.lamps
    for node in nodes:
        if node.density is not None and tree:
            yield node.parent, *((REFRACTED, "refracted ray") if node.number % 2 else (REFLECTED, "reflected ray"))
        elif node.density is not None:
            together = transport.settings.diffuse_bounces < 0 or "diffuse" in node.lobe
            yield node.parent, *((DIFFUSE, "next ray") if together else (REFLECTED, "specular ray"))
        for k, lamp in enumerate(node.lamps):
            if lamp.state in LIT:
                yield node.number, NODE_SPACES + (k if tree else k * lamps), lamp.lamp if tree else "lamp"
