"""BSDFs that do not tell their lobes apart.

What they say under the type mask of a ``mi.BSDFContext`` cannot be relied on, so they are taken whole: sources are
sampled for all of their lobes together, and of a ray that is drawn it is looked at afterwards which lobe it belongs to.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..masks import but_not
from ..optics.nested import all_within
from . import lobes
from .shapes import all_shapes

#: Class names of Mitsuba's BSDFs that have components by name, but evaluate all of them.
BY_NAME_ONLY = ("Principled", "PrincipledThin")


def is_indivisible(bsdf: mi.BSDF) -> bool:
    """Whether ``bsdf``, or one within it, is of this kind: known to be, or with a component of several lobes (hair)."""
    return any(
        one.class_name() in BY_NAME_ONLY or any(_lobes_of(one.flags(i)) > 1 for i in range(one.component_count()))
        for one in all_within(bsdf)
    )


def any_indivisible(scene: mi.Scene) -> bool:
    """Whether any surface of ``scene``, those of instances included, is of this kind."""
    return any(is_indivisible(shape.bsdf()) for shape in all_shapes(scene) if shape.bsdf() is not None)


def is_whole(bsdf: mi.BSDF | mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
    """Which of the BSDFs ``bsdf`` (``mi.BSDFPtr``, or one in scalar variants) are taken whole."""
    if not dr.is_jit_v(mi.Float):
        return is_indivisible(bsdf)
    return dr.dispatch(bsdf, lambda one, active: mi.Bool(is_indivisible(one)), active)


def _lobes_of(flags: int) -> int:
    return sum(bool(lobes.has_any(int(flags), *names)) for names in (lobes.REFLECTED, lobes.REFRACTED, lobes.DIFFUSE))


def belongs_to(lobe: mi.BSDFContext, wi: mi.Vector3f, bs: mi.BSDFSample3f) -> mi.Bool:
    """Whether the sample ``bs`` of a whole BSDF counts for ``lobe``: each sample does for just one of the lobes that
    are followed apart, a specular one by the side that it goes to.
    """
    diffuse = but_not(
        lobes.has_any(bs.sampled_type, *lobes.DIFFUSE),
        lobes.has_any(bs.sampled_type, *lobes.REFLECTED, *lobes.REFRACTED),
    )
    through = mi.Frame3f.cos_theta(wi) * mi.Frame3f.cos_theta(bs.wo) < 0
    asked = [bool(lobes.has_any(lobe.type_mask, *names)) for names in (lobes.DIFFUSE, lobes.REFRACTED, lobes.REFLECTED)]
    is_diffuse, is_refracted, is_reflected = (
        diffuse,
        but_not(through, diffuse),
        but_not(but_not(mi.Bool(True), through), diffuse),
    )
    return (is_diffuse & asked[0]) | (is_refracted & asked[1]) | (is_reflected & asked[2])
