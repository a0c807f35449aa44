"""Translates a SURFACE to a BSDF of this project's plugins, and computes properties of a SURFACE that the targets
``prosim`` and ``stock`` both need.
"""

import math
from dataclasses import dataclass

from ..language.words import INDICES, numbers_of
from ..model import GREY, Leaf, Method, Surface, Texture, Vector
from ..nodes import Node, rgb
from . import textures
from .translation_context import Context

BLACK = (0.0, 0.0, 0.0)
#: The smallest absorption of a channel, relative to the largest. Mitsuba's ``volpath`` returns NaN for no absorption.
MIN_ABSORPTION = 1e-7
#: The exponent of facets divided by the exponent of an equally wide lobe about the mirror direction. If a facet turns
#: by an angle, the reflected ray turns by twice the angle; exponents are inverse squares of angles.
SQUARED_ANGLES = 4
#: The largest exponent of a BSDF.
MAX_EXPONENT = numbers_of("OPTIC", "exponent").high


@dataclass(frozen=True)
class MediumInterface:
    """The media on the two sides of a face; each medium is represented by the index of a SURFACE whose primitives
    consist of this medium.

    ``inside`` is the SURFACE index of the medium on the inner side of the face; for an opaque primitive, it is the
    index of the primitive's SURFACE. ``outside`` is the SURFACE index of the medium on the outer side of the face; None
    is air.
    """

    inside: int
    outside: int | None = None


def roughness_parameters(surface: Surface, method: Method) -> Node:
    """Returns the parameters for the roughness of a surface of facets; none if it is smooth."""
    multiple = {"multiple_scattering": True} if method.multiple_scattering else {}
    exponent = surface.facet_exponent
    if surface.exponent is not None:
        exponent = min(SQUARED_ANGLES * surface.exponent, MAX_EXPONENT)
    if exponent is not None:
        return {"distribution": "phong", "exponent": exponent, **multiple}
    return {"distribution": method.facets, "alpha": surface.slope, **multiple} if surface.slope else {}


def reflectances(surface: Surface) -> tuple[Vector, Vector, Vector]:
    """Returns kd, ks and ka of a surface; values that the scene does not state are defaults of the material."""
    kd = surface.kd or GREY
    ks = surface.ks or ((1 - kd[0], 1 - kd[1], 1 - kd[2]) if surface.material == "composite" else BLACK)
    ka = surface.ka
    if ka is None:
        ka = BLACK if surface.material in ("conductor", "dielectric") else kd
    return kd, ks, ka


def effective_textures(leaf: Leaf, surface: Surface) -> tuple[Texture | None, Texture | None]:
    """Returns the two textures of a primitive; both are None if its material ignores textures."""
    return leaf.textures if surface.material not in ("conductor", "dielectric") else (None, None)


def mean_index(context: Context, index: int | None) -> float:
    """Returns the index of refraction of the medium inside primitives with SURFACE number ``index``; if ``index`` is
    None, that of the air.

    For a glass that is given by name, the result is its index of refraction at 587.6 nm. For other surfaces, the result
    is the mean of the indices of refraction of the channels r, g and b; if they differ, a warning is emitted, but only
    once for a whole translation.
    """
    if index is None:
        return context.scene.air_index
    surface = context.scene.surfaces[index]
    if surface.glass:
        return INDICES[surface.glass]
    assert surface.eta is not None
    if len(set(surface.eta)) > 1:
        reason = "n-refr differs between channels: its mean is used, without dispersion; "
        context.warn_once(f"{reason}for dispersion use abbe, or a glass's name", "surfaces", index)
    return sum(surface.eta) / 3


def mean_indices(context: Context, sides: MediumInterface) -> Node:
    """Returns the BSDF parameters ``int_ior`` and ``ext_ior``, which are mean indices of refraction."""
    return {"int_ior": mean_index(context, sides.inside), "ext_ior": mean_index(context, sides.outside)}


def bsdf(context: Context, number: int, leaf: Leaf, sides: MediumInterface) -> Node:
    """Returns the BSDF, a plugin of this project, of ``leaf``, node ``number``; its textures multiply diffuse and
    ambient reflectance. Without a material, it is a classic Phong surface.
    """
    surface = context.scene.surfaces[leaf.index]
    method = context.scene.method
    (kd, ks, ka), rough = reflectances(surface), roughness_parameters(surface, method)

    def textured(name: str, color: Vector) -> Node:
        return textures.reflectance(context, number, leaf, effective_textures(leaf, surface), name, color)

    if surface.material == "conductor":
        node: Node = {"type": "prosim_conductor", "ext_ior": mean_index(context, sides.outside), **rough}
        node |= {"fresnel": "thesis"} if method.fresnel == "thesis" else {}
        if surface.metal:
            node["material"] = surface.metal
        elif surface.eta and surface.k:
            node |= {"eta": rgb(surface.eta), "k": rgb(surface.k)}
    elif surface.material == "dielectric":
        inside, outside = _refraction(context, sides.inside), _refraction(context, sides.outside)
        node = {"type": "prosim_dielectric"} | {f"int_{name}": value for name, value in inside.items()}
        node |= {f"ext_{name}": value for name, value in outside.items()}
        node |= rough if inside != outside else {}  # the roughness of a face between equal media has no effect
    elif surface.material == "lambertian":
        node = {"type": "prosim_lambertian", "reflectance": textured("kd", kd)}
    elif surface.material == "composite":
        per_channel = surface.eta is not None and len(set(surface.eta)) > 1  # a coat refracts no ray
        node = {
            "type": "prosim_composite",
            "diffuse_reflectance": textured("kd", kd),
            "specular_reflectance": rgb(ks),
            "int_ior": rgb(surface.eta or ()) if per_channel else mean_index(context, sides.inside),
            "ext_ior": mean_index(context, sides.outside),
            **rough,
        }
    else:
        node = {"type": "prosim_phong", "diffuse_reflectance": textured("kd", kd), "specular_reflectance": rgb(ks)}
        if (exponent := phong_exponent(surface)) is not None:
            node["exponent"] = exponent
        node |= {"normalized": False} if method.phong == "literal" else {}
    # The parameter is left out if it has the plugin's default: kd for lambertiano and composto, else black.
    if any(ka) if surface.material not in ("lambertian", "composite") else surface.ka is not None:
        node["ambient"] = textured("ka", ka)
    return node


def _refraction(context: Context, index: int | None) -> Node:
    """Returns BSDF parameters for the refraction of the medium of SURFACE ``index``, or of the air."""
    surface = Surface() if index is None else context.scene.surfaces[index]
    if surface.glass:
        return {"material": surface.glass}
    dispersion = {} if surface.abbe is None else {"abbe": float(surface.abbe)}
    return {"ior": mean_index(context, index), **dispersion}


def absorbs(surface: Surface) -> bool:
    """Whether the medium inside primitives with the SURFACE ``surface`` absorbs light."""
    return surface.material == "dielectric" and min(surface.transmittance or (1.0,)) < 1


def media(context: Context, sides: MediumInterface) -> Node:
    """Returns the absorbing media of both sides as parameters of the shape; none for air or clear ones."""
    sides_by_name = {"interior": sides.inside, "exterior": sides.outside}
    surfaces = {name: context.scene.surfaces[i] for name, i in sides_by_name.items() if i is not None}
    return {name: _absorbing_medium(surface) for name, surface in surfaces.items() if absorbs(surface)}


def _absorbing_medium(surface: Surface) -> Node:
    """Returns the dictionary of the absorbing medium inside primitives with the SURFACE ``surface``."""
    assert surface.transmittance is not None
    sigma = [-math.log(t) / surface.thickness for t in surface.transmittance]
    scale = max(sigma)
    relative = rgb(max(channel / scale, MIN_ABSORPTION) for channel in sigma)
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": relative, "scale": scale}


def phong_exponent(surface: Surface) -> float | None:
    """Returns the exponent of the lobe about the mirror direction, or None for a mirror; a slope m of facets is about
    as rough as 2/m^2 - 2 (Walter et al. 2007).
    """
    facets = surface.facet_exponent
    if surface.slope:
        facets = min(max(2 / surface.slope**2 - 2, 0.0), SQUARED_ANGLES * MAX_EXPONENT)
    return surface.exponent if facets is None else facets / SQUARED_ANGLES


def beckmann_slope(surface: Surface) -> float:
    """Returns the RMS slope m of a surface, 0 if it is smooth; an exponent n of facets is m = sqrt(2/(n + 2)) (Walter
    et al. 2007).
    """
    exponent = roughness_parameters(surface, Method()).get("exponent")
    return surface.slope or 0.0 if exponent is None else math.sqrt(2 / (exponent + 2))
