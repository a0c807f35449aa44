"""Traversal of BSDFs and scenes, including nested BSDFs and the shapes within instances."""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from ..compat import BLEND, INSTANCE, MAPS, MASK, TWO_SIDED, is_users

#: The BSDF attribute with the reflectance of ambient light.
AMBIENT = "ambient"


@functools.cache
def _callback(variant: str) -> type:
    """Returns the class of traversal callbacks for ``variant``, always the same one: a new class for each call would
    stay in memory, in a reference cycle, until Python's next garbage collection.
    """

    class Parts(mi.TraversalCallback):
        def __init__(self) -> None:
            super().__init__()
            self.found: dict[str, Any] = {}

        def put(self, name: str, value: Any, flags: Any, *_: Any) -> None:
            # The shapes of a group, or other parts, have equal names if they have no ids.
            self.found[f"{name} {len(self.found)}" if name in self.found else name] = value

    return Parts


def parts(thing: mi.Object) -> dict[str, Any]:
    """Returns the parameters and child objects of ``thing``, by their names in ``mi.traverse``; another one with the
    name of an earlier one has a number after this name.
    """
    callback = _callback(mi.variant())()
    try:
        thing.traverse(callback)
    except Exception:
        if not is_users(thing):  # a user's method, which ``mi.render`` never calls, may raise anything
            raise
    return callback.found


def all_within(bsdf: mi.BSDF) -> list[mi.BSDF]:
    """Returns ``bsdf`` and all BSDFs nested in it, at any depth, each once: a user's may expose itself."""
    found = [bsdf]
    for one in found:
        found += [p for p in parts(one).values() if isinstance(p, mi.BSDF) and p not in found]
    return found


def all_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """Returns the shapes of ``scene``, and the shapes within the instances of the scene."""
    shapes = list(scene.shapes())
    if any(shape.class_name() == INSTANCE for shape in shapes):
        # The shapes that are instanced are not in ``scene.shapes()``, but are parts of the scene's groups of shapes.
        groups = [part for part in parts(scene).values() if isinstance(part, mi.Shape)]
        shapes += [s for group in groups for s in parts(group).values() if isinstance(s, mi.Shape)]
    return shapes


def all_bsdfs(scene: mi.Scene) -> list[mi.BSDF]:
    """Returns the BSDFs of all shapes of ``scene``, each BSDF once."""
    return list(dict.fromkeys(shape.bsdf() for shape in all_shapes(scene) if shape.bsdf() is not None))


def all_flags(scene: mi.Scene) -> int:
    """Returns the union of the ``mi.BSDFFlags`` of all BSDFs of ``scene``."""
    return functools.reduce(operator.or_, (int(bsdf.flags()) for bsdf in all_bsdfs(scene)), 0)


class Leaf(NamedTuple):
    """A BSDF in a mixture of BSDFs; the BSDF itself is no ``blendbsdf``, ``mask`` or ``twosided``."""

    #: Weight of the leaf in the mixture.
    share: mi.Float
    #: The BSDF; None for the null lobe of a ``mask``.
    bsdf: mi.BSDF | None
    #: The interaction as the leaf needs it: if the leaf is in a ``twosided``, the viewer is on the front side.
    si: mi.SurfaceInteraction3f


def leaves(bsdf: mi.BSDF | None, si: mi.SurfaceInteraction3f, active: mi.Bool) -> list[Leaf]:
    """Returns the BSDFs that ``bsdf`` mixes at the surface point ``si``, with weights that sum up to 1.

    The BSDFs in Mitsuba's ``blendbsdf``, ``mask`` and ``twosided`` are mixed, at any depth; any other ``bsdf`` is the
    only leaf. The hole of a ``mask`` is a leaf whose BSDF is None. In a ``twosided``, the BSDF of the viewer's side has
    the weight 1, and the other 0. Mitsuba divides [0, 1] into an interval for each BSDF; the leaves are in the order of
    their intervals.
    """
    if bsdf is None:
        return [Leaf(mi.Float(1), None, si)]
    kind, inner = bsdf.class_name(), parts(bsdf)
    if kind == BLEND:
        weight = dr.clip(inner["weight"].eval_1(si, active), 0, 1)
        halves = (weight, inner["bsdf_1"]), (1 - weight, inner["bsdf_0"])
    elif kind == MASK:
        opacity = dr.clip(inner["opacity"].eval_1(si, active), 0, 1)
        halves = (opacity, inner["nested_bsdf"]), (1 - opacity, None)
    elif kind == TWO_SIDED:
        front, si = dr.select(mi.Frame3f.cos_theta(si.wi) > 0, mi.Float(1), 0), mi.SurfaceInteraction3f(si)
        si.wi.z = dr.abs(si.wi.z)
        halves = (front, inner["brdf_0"]), (1 - front, inner["brdf_1"])
    else:
        return [Leaf(mi.Float(1), bsdf, si)]
    return [leaf._replace(share=share * leaf.share) for share, half in halves for leaf in leaves(half, si, active)]


def ambient_reflectance(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
    """Returns the fraction of the ambient light that ``bsdf`` reflects towards ``si.wi``; 0 for a BSDF without the
    attribute ``ambient``, and on the back of a one-sided BSDF.

    For an array of BSDFs, call this function by ``dr.dispatch``. Mitsuba's mixtures and maps hide the attributes of
    their nested BSDFs, so this function evaluates the nested BSDFs.
    """
    total = mi.UnpolarizedSpectrum(0)
    for leaf in leaves(bsdf, si, active):
        if leaf.bsdf is not None:
            total += leaf.share * _ambient_of(leaf.bsdf, leaf.si, active)
    return total


def _ambient_of(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UnpolarizedSpectrum:
    """Returns the ambient reflectance of ``bsdf``, which is no ``mask``, ``blendbsdf`` or ``twosided``."""
    if bsdf.class_name() in MAPS:
        return ambient_reflectance(parts(bsdf)["nested_bsdf"], si, active)
    if not dr.all(bsdf.has_attribute(AMBIENT)):  # evaluating a missing attribute is an error in scalar variants
        return mi.UnpolarizedSpectrum(0)
    visible = True if mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide) else si.wi.z > 0
    return dr.select(active & visible, bsdf.eval_attribute(AMBIENT, si, active), 0)
