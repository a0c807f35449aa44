"""Makes the page that explains a pixel: one HTML file that needs no other files."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from typing import Any

import mitsuba as mi
import numpy as np

from ..compat import world_matrix
from ..engine.estimator import Estimator
from .nodes import Node

#: Number of the brightest samples whose rays are on the page, and their maximum size in characters; maximum number of
#: lamps of a node.
BRIGHTEST, MOST_CHARACTERS, MOST_LAMPS = 8, 1 << 20, 16


def html(facts: Mapping[str, Any], trees: Mapping[int, Sequence[Node]], **more: Any) -> str:
    """Returns the HTML text of the page. ``facts`` are those of an explanation, and ``trees`` maps samples to their
    nodes; trees that would make the page too large are left out. ``more``: :attr:`.Explanation.drawing`, and the image.
    """
    lobes = more.pop("lobes")
    stored = [{"sample": k, "nodes": [*map(shown, nodes)], "lobes": lobes.get(k, {})} for k, nodes in trees.items()]
    while len(stored) > 1 and len(json.dumps(stored)) > MOST_CHARACTERS:
        stored.pop()
    data = {"name": "the image", "image": "", **facts, "nodes": [], "drawing": {}, "trees": stored, **more}
    page, script = (
        files(__package__).joinpath(f"explanation_page.{kind}").read_text("utf-8") for kind in ("html", "js")
    )
    return page.replace("SCRIPT", script).replace("DATA", json.dumps(data).replace("<", "\\u003c"))


def shown(node: Node) -> dict[str, Any]:
    """Returns what the page shows of a node: at most :data:`MOST_LAMPS` lamps, and the sum of the others."""
    light = [
        sum(lamp.weighted_radiance) * sum(sum(lobe.bsdf) * lobe.weight for lobe in lamp.lobes) for lamp in node.lamps
    ]
    order = sorted(range(len(light)), key=lambda k: -light[k])
    kept, left = sorted(order[:MOST_LAMPS]), order[MOST_LAMPS:]
    others = [*map(sum, zip(*(node.lamps[k].contribution for k in left)))]
    return asdict(replace(node, lamps=tuple(node.lamps[k] for k in kept))) | {"others": others, "left": len(left)}


def policy(page: str) -> str:
    """Returns the Content-Security-Policy that lets ``page`` use only its own script, styles and images."""
    kinds = {"script": "<script>(.*?)</script>", "style": "<style>(.*?)</style>"}
    texts = {kind: re.findall(pattern, page, re.DOTALL)[0].encode() for kind, pattern in kinds.items()}
    hashes = {kind: base64.b64encode(hashlib.sha256(text).digest()).decode() for kind, text in texts.items()}
    allowed = "; ".join(f"{kind}-src 'sha256-{digest}'" for kind, digest in hashes.items())
    return (
        f"sandbox allow-scripts; default-src 'none'; {allowed}; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


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
    return {
        "origin": world_matrix(sensor)[:3, 3].tolist(),
        "matrix": matrix.tolist(),
        "size": [int(n) for n in film.size()],
        "offset": [int(n) for n in film.crop_offset()],
    }
