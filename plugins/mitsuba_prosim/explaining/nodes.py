"""The rays of one sample of a pixel, and the light that each ray adds, as plain data.

Numbers of a light or of a throughput are tuples: the values of a contribution are those of the film's channels (linear
red, green and blue); all others have one value per colour or wavelength of the variant. Densities are per solid angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

Numbers: TypeAlias = "tuple[float, ...]"


@dataclass(frozen=True)
class LobeShare:
    """The share of one group of lobes in the light that a surface scatters from a sampled point of a lamp."""

    name: str
    #: BSDF value times the cosine.
    bsdf: Numbers
    #: Density with which the lobes sample the direction of the point; 0 for lobes whose rays do not look for lamps.
    density: float
    #: MIS weight of the lamp's sample against the rays of the lobes, and against photons.
    weight: float


@dataclass(frozen=True)
class LampSample:
    """A sampled point of a lamp, and the light that a surface scatters from this point."""

    lamp: str
    point: Numbers
    #: "visible", "hidden", or "dark": the lamp sends no light here, or the surface scatters none of it to the viewer.
    state: str
    #: The shape that hides the point; None for a point that is not hidden.
    occluder: str | None
    #: Density of the point, with the probability of the choice of the lamp; 1 for a lamp without extent.
    density: float
    #: Radiance of the point, divided by ``density``.
    weighted_radiance: Numbers
    lobes: tuple[LobeShare, ...]
    #: The light that the point adds to the sample of the pixel.
    contribution: Numbers


@dataclass(frozen=True)
class Emission:
    """The light of a lamp that a ray meets."""

    lamp: str
    radiance: Numbers
    #: Density with which light sampling takes the direction of the ray; 0 if it never does.
    density: float
    #: MIS weight of the ray against light sampling, and against photons.
    weight: float
    contribution: Numbers


@dataclass(frozen=True)
class Node:
    """A ray of a tree or path, the surface point that it meets, and the light that it adds to the sample."""

    #: Number of the node; 1 is the camera ray. In a tree, node n reflects node 2 n and refracts node 2 n + 1.
    number: int
    #: Number of the node where the ray begins; 0 is the camera.
    parent: int
    #: Number of reflections and refractions before the ray.
    level: int
    #: The shape that the ray meets, and its line in the scene file where known; None if the ray leaves the scene.
    shape: str | None
    line: str | None
    origin: Numbers
    direction: Numbers
    #: Where the ray meets the shape, and the shading normal on the ray's side; None if the ray leaves the scene.
    position: Numbers | None
    normal: Numbers | None
    #: The lobe through which the ray leaves its parent, such as "glossy reflection"; "camera" for the camera ray.
    lobe: str
    #: Density of the direction; None for the camera ray and for a lobe with a single direction.
    density: float | None
    #: Probability of the choice of a lobe with a single direction among the lobes that share one random number; None
    #: for other lobes.
    probability: float | None
    #: Probability that the ray survives Russian roulette, times the probability of the choice of its lobe in a path.
    survival: float
    #: Factor from the radiance of the ray at its end to the radiance of the camera ray.
    throughput: Numbers
    lamps: tuple[LampSample, ...]
    emission: Emission | None
    #: The light that the ambient term, the background and photons add.
    ambient: Numbers
    background: Numbers
    photons: Numbers
    #: The light that the node adds to the sample: the sum of all contributions above.
    contribution: Numbers
