"""Makes the page that explains a pixel: one HTML file that needs no other files.

The squares of random numbers on the page are the patterns of the thesis (figures 4.7, 5.10 and 5.11).
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
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
from ..transport import lobes
from .recorder import LIT, Node

#: Number of the brightest samples whose rays are on the page, and their maximum size in characters; maximum number of
#: lamps of a node.
BRIGHTEST, MOST_CHARACTERS, MOST_LAMPS = 8, 1 << 20, 16
#: Maximum numbers of samples in a pattern, of patterns, and of nodes with lobes; number of directions of a lobe.
MOST_POINTS, MOST_PATTERNS, MOST_LOBES, DIRECTIONS = 256, 128, 1024, 32


def html(facts: Mapping[str, Any], trees: Mapping[int, Sequence[Node]], **more: Any) -> str:
    """Returns the HTML text of the page. ``facts`` are those of an explanation, and ``trees`` maps samples to their
    nodes; trees that would make the page too large are left out. ``more``: :attr:`.Explanation.drawing`, and the image.
    """
    surfaces = more.pop("surfaces")
    stored = [{"sample": k, "nodes": [*map(shown, nodes)], "surfaces": surfaces[k]} for k, nodes in trees.items()]
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


def policy(page: str) -> str:
    """Returns the Content-Security-Policy that lets ``page`` use only its own script, styles and images."""
    hashes = {}
    for kind in ("script", "style"):
        (text, *_) = re.findall(f"<{kind}>(.*?)</{kind}>", page, re.DOTALL)
        hashes[kind] = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    allowed = "; ".join(f"{kind}-src 'sha256-{digest}'" for kind, digest in hashes.items())
    others = "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    return f"sandbox allow-scripts; default-src 'none'; {allowed}; {others}"


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


def surfaces(estimator: Estimator, trees: Mapping[int, Sequence[Node]]) -> dict[int, dict[int, Any]]:
    """Returns sample -> index of a node -> ``(vectors, texts)`` of the surface where the node's ray ends.

    The vectors are sampled directions of the BSDF, whose length is the BSDF value times the cosine, relative to the
    greatest. Lobes with a single direction have no vectors. The texts name the textures and their values there.
    """
    found: dict[int, dict[int, Any]] = {sample: {} for sample in trees}
    met = [(sample, i) for sample, nodes in trees.items() for i, node in enumerate(nodes) if node.position][:MOST_LOBES]
    if not met:
        return found
    p, o, d = (
        np.repeat([getattr(trees[sample][i], name) for sample, i in met], DIRECTIONS, axis=0).T
        for name in ("position", "origin", "direction")
    )
    wavelengths = estimator.rays(mi.Float(0), mi.Float(0.5), mi.Point2f(0.5), mi.Point2f(0.5))[0].wavelengths
    ray = mi.Ray3f(mi.Point3f(p + 0.01 * (o - p)), mi.Vector3f(d), 0.0, wavelengths)
    si = estimator.scene.ray_intersect(ray)
    i = dr.arange(mi.UInt32, len(met) * DIRECTIONS) % DIRECTIONS
    u, v, choice = ((mi.Float(i) + 0.5) * step for step in (0.7548777, 0.5698403, 0.6180340))  # even (Roberts 2018)
    u, v, choice = (number - dr.floor(number) for number in (u, v, choice))
    bs, weight = si.bsdf().sample(mi.BSDFContext(), si, choice, mi.Point2f(u, v), si.is_valid())
    length = dr.select(lobes.has_any(bs.sampled_type, *lobes.IDEAL), 0, dr.max(weight) * bs.pdf)
    vectors = np.nan_to_num(np.array(si.to_world(bs.wo) * length)).T.reshape(len(met), DIRECTIONS, 3)
    longest = np.linalg.norm(vectors, axis=2).max(axis=1)
    for (sample, i), v, most, texts in zip(met, vectors, longest, texture_texts(si)):
        found[sample][i] = np.round(v.ravel() / most, 3).tolist() if most > 0 else [], texts
    return found


def texture_texts(si: mi.SurfaceInteraction3f) -> list[list[str]]:
    """Returns texts on the textures at each :data:`DIRECTIONS`-th surface point: their names, parts and values."""
    pointers = si.bsdf()
    numbers = np.array(dr.reinterpret_array(mi.UInt32, pointers))
    texts: list[list[str]] = [[] for _ in numbers[::DIRECTIONS]]
    for number in np.unique(numbers[numbers > 0]):
        points = np.flatnonzero(numbers == number)[::DIRECTIONS]
        parts = mi.traverse(pointers[int(points[0])])
        paths = {node: key.rpartition(".")[0] for key, (_, _, node, *_) in parts.properties.items()}
        for texture in parts.hierarchy:
            if not isinstance(texture, mi.Texture) or not texture.is_spatially_varying():
                continue
            mixes, kind = hasattr(texture, "TOP"), type(texture).__name__
            shares = np.array(texture.value(si)) if mixes else numbers
            colours = np.array(dr.zeros(mi.Spectrum, len(numbers)) + texture.eval(si)).T
            for i in points:
                mix = f"{shares[i]:.0%} {texture.TOP[0]}, {1 - shares[i]:.0%} {texture.BASE[0]}" if mixes else "value"
                name = f"{paths.get(texture, '')} {kind if mixes else texture.class_name().partition('Impl')[0]}"
                texts[i // DIRECTIONS].append(f"{name}: {mix} – {' '.join(f'{v:.3g}' for v in colours[i])}".lstrip())
    return texts
