"""Data that only the page shows: the random numbers of all samples of a pixel, and the lobes of the surfaces.

The squares of random numbers are the patterns of the thesis (figures 4.7, 5.10 and 5.11).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import dr_array
from ..engine.estimator import Estimator
from ..engine.plan import Plan
from ..sampling.spaces import DIFFUSE, LENS, NODE_SPACES, PIXEL, REFLECTED, REFRACTED
from ..transport import lobes
from .nodes import Node

#: Maximum numbers of samples in a pattern, of patterns, and of nodes with lobes; number of directions of a lobe.
MOST_POINTS, MOST_PATTERNS, MOST_LOBES, DIRECTIONS = 256, 128, 1024, 32


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
            if lamp.state != "dark":
                yield node.number, NODE_SPACES + (k if tree else k * lamps), lamp.lamp if tree else "lamp"


def lobe_directions(estimator: Estimator, trees: Mapping[int, Sequence[Node]]) -> dict[int, dict[int, list[float]]]:
    """Returns sampled directions of the BSDFs where the rays of ``trees`` end: sample -> index of a node -> vectors.

    The length of a vector is the BSDF value times the cosine, relative to the greatest. Lobes with a single direction
    have no vectors.
    """
    found: dict[int, dict[int, list[float]]] = {sample: {} for sample in trees}
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
    for (sample, i), v, most in zip(met, vectors, longest):
        if most > 0:
            found[sample][i] = np.round(v.ravel() / most, 3).tolist()
    return found
