"""SURFACE -> BSDF."""

from . import textures
from .textures import rgb


def roughness(surface):
    if surface.exponent is not None:
        return {"distribution": "phong", "exponent": surface.exponent}
    if surface.slope:
        return {"distribution": "beckmann", "alpha": surface.slope}
    return {}


def defaults(surface):
    """kd, ks and ka of a surface, with the defaults of its material."""
    kd = surface.kd or (0.5, 0.5, 0.5)
    ks = surface.ks or (tuple(1 - x for x in kd) if surface.material == "composite" else (0.0, 0.0, 0.0))
    ka = surface.ka
    if ka is None:
        ka = (0.0, 0.0, 0.0) if surface.material in ("conductor", "dielectric") else kd
    return kd, ks, ka


def mean_index(scene, surface, approximate):
    """The index of refraction as one number; per-channel ones are averaged, and said so."""
    if len(set(surface.eta)) > 1:
        approximate(surface.at, "the index of refraction differs from channel to channel: its mean is used, without dispersion")
    return sum(surface.eta) / 3


def bsdf(scene, surface, slots, to_local, images, approximate):
    """The BSDF of this project's plugins for a surface and the textures of a primitive."""
    kd, ks, ka = defaults(surface)

    def textured(color):
        return textures.reflectance(scene, color, slots, to_local, images)

    air = scene.air_index
    if surface.material == "conductor":
        node = {"type": "prosim_conductor", "ext_ior": air, **roughness(surface)}
        if surface.metal:
            node["material"] = surface.metal
        else:
            node |= {"eta": rgb(surface.eta), "k": rgb(surface.k)}
    elif surface.material == "dielectric":
        node = {"type": "prosim_dielectric", "int_ior": mean_index(scene, surface, approximate), "ext_ior": air,
                **roughness(surface)}
    elif surface.material == "lambertian":
        node = {"type": "prosim_lambertian", "reflectance": textured(kd)}
    elif surface.material == "composite":
        node = {"type": "prosim_composite", "diffuse_reflectance": textured(kd), "specular_reflectance": rgb(ks),
                "int_ior": mean_index(scene, surface, approximate), "ext_ior": air, **roughness(surface)}
    else:
        node = {"type": "prosim_phong", "diffuse_reflectance": textured(kd), "specular_reflectance": rgb(ks)}
        if (exponent := phong_exponent(surface)) is not None:
            node["exponent"] = exponent
    if any(ka) if surface.material not in ("lambertian", "composite") else surface.ka is not None:
        node["ambient"] = textured(ka)
    return node


def phong_exponent(surface):
    """Exponent of the Phong lobe, None for a mirror; an RMS slope m is converted by n = 2/m^2 - 2 (Walter et al. 2007)."""
    if surface.exponent is None and surface.slope:
        return max(2 / surface.slope**2 - 2, 0.0)
    return surface.exponent


