"""Draws the figures of chapters 2 and 3 from curves of the plugins."""

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba_prosim.optics import facets

from . import curves

RGB = ("#c33", "#393", "#33c")


def fresnel_axes(figure, title):
    """Axes for the reflectance over the angle of incidence."""
    axes = figure.add_subplot(
        xlim=(0, 90),
        ylim=(0, 1),
        title=title,
        xticks=range(0, 91, 15),
        xlabel="angle of incidence (degrees)",
        ylabel="reflectance",
    )
    axes.grid(alpha=0.3)
    return axes


def dielectric_outside(figure):
    """Reflectance of dielectrics for light from air (figure 2.4)."""
    axes = fresnel_axes(figure, "From air into a dielectric")
    angles = np.linspace(0, 89.99, 200)
    for n in (1.3, 1.5, 2.0, 2.5):
        bsdf = mi.load_dict({"type": "prosim_dielectric", "int_ior": n, "ext_ior": 1.0})
        axes.plot(angles, np.array(curves.reflectance(bsdf, angles))[0], label=f"n = {n}")
    axes.legend()


def dielectric_inside(figure):
    """Reflectance of dielectrics for light from inside, with total reflection (figure 2.5)."""
    axes = fresnel_axes(figure, "From a dielectric into air")
    angles = np.linspace(0, 89.99, 500)
    for n in (1.3, 1.5, 2.0, 2.5):
        bsdf = mi.load_dict({"type": "prosim_dielectric", "int_ior": n, "ext_ior": 1.0})
        axes.plot(
            angles,
            np.array(curves.reflectance(bsdf, 180 - angles))[0],
            label=f"n = {n}: total\nfrom {np.degrees(np.arcsin(1 / n)):.1f}°",
        )
    axes.legend(loc="center right")


def copper(figure):
    """Reflectance of copper in red, green and blue: exact, and by the thesis's approximation (figure 2.6)."""
    axes = fresnel_axes(figure, "Copper in air")
    angles = np.linspace(0, 89.99, 200)
    for fresnel, style in (("exact", "-"), ("thesis", ":")):
        bsdf = mi.load_dict({"type": "prosim_conductor", "material": "Cu_palik", "fresnel": fresnel})
        for values, color, name in zip(np.array(curves.reflectance(bsdf, angles)), RGB, ("red", "green", "blue")):
            axes.plot(angles, values, style, color=color, label=name if style == "-" else None)
    axes.plot([], [], "k:", label="n² + k² >> 1")
    axes.set_ylim(0.4, 1)
    axes.legend(loc=(0.05, 0.45))


def half_circle(figure, place, title):
    """Polar axes above a surface: 0 is the normal, and positive angles are to the right."""
    axes = figure.add_subplot(place, projection="polar")
    axes.set(theta_zero_location="N", theta_direction=-1, thetamin=-90, thetamax=90, yticklabels=[])
    axes.grid(alpha=0.3)
    axes.text(0.5, 0.1, title, transform=axes.transAxes, ha="center")
    return axes


def beckmann(figure):
    """Beckmann's distribution of facet normals for two values of the RMS slope m (figure 3.3)."""
    angles = np.radians(np.linspace(-89.9, 89.9, 601))
    m = mi.Vector3f(np.sin(angles), 0, np.cos(angles))
    for place, alpha in ((121, 0.2), (122, 0.6)):
        axes = half_circle(figure, place, f"m = {alpha}")
        axes.plot(angles, np.array(facets.beckmann(m, mi.Float(alpha))))


def lobes(figure, incidence):
    """Lobes of the models of Torrance-Sparrow and of Phong, with similar widths, each with the same diffuse
    component.
    """
    angles = np.linspace(-89.5, 89.5, 719)
    slope, diffuse = 0.2, 0.75
    specular = 1 - diffuse
    models = {
        "Torrance-Sparrow": {"type": "prosim_conductor", "material": "none", "alpha": slope},
        # A lobe about the mirror direction is twice as wide as one about the half vector: a quarter of the exponent.
        "Phong": {
            "type": "prosim_phong",
            "diffuse_reflectance": 0.0,
            "specular_reflectance": 1.0,
            "exponent": (2 / slope**2 - 2) / 4,
        },
    }
    for place, (name, description) in zip((121, 122), models.items()):
        bsdf = mi.load_dict(description)
        values = specular * np.array(curves.radiance(bsdf, dr.full(mi.Float, incidence, len(angles)), angles))[0]
        values += diffuse / np.pi
        peak = angles[values.argmax()]
        axes = half_circle(figure, place, f"{name}: peak at {peak:.0f}°")
        axes.plot(np.radians(angles), values)
        top = 1.1 * values.max()
        axes.plot(np.radians([-incidence] * 2), [0, top], "k-", lw=0.8)
        axes.plot(np.radians([incidence] * 2), [0, top], "k--", lw=0.8)
        axes.set_ylim(0, top)
