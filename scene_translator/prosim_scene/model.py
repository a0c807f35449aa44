"""The classes of a scene's contents, such as lights, primitives and materials; their objects are immutable. The module
``language.document`` stores the position of each value of a scene in the scene's text.
"""

from dataclasses import dataclass, field
from functools import cached_property

Vector = tuple[float, float, float]

#: The default diffuse reflectance kd.
GREY: Vector = (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class Light:
    """A light source (section 5.2 of the thesis): a sphere, a point, or a sky. A point light has no size; with the
    light units "radiance", its ``radius`` scales its intensity.
    """

    kind: str  # "area", "point", or "sky": an environment image, for which only ``image`` has a meaning
    position: Vector = (0.0, 0.0, 0.0)
    intensity: Vector = (65535.0, 65535.0, 65535.0)  # r, g, b; 65535 is 1.0
    radius: float = 1.0
    distribution: str = "uniform"  # or "cone", "spot"
    direction: Vector = (0.0, -1.0, 0.0)
    angle: float | None = None  # the largest angle from the axis in degrees, of a cone or a spot
    exponent: float = 1.0  # n of a spot, whose intensity is proportional to cos^n
    image: str | None = None  # the file of a sky's latitude-longitude image


@dataclass(frozen=True)
class Background:
    """The background of a scene: the radiance ``color`` of rays that leave the scene (65535 is 1.0), or the file name
    ``image`` of a latitude-longitude image.
    """

    color: Vector = (0.0, 0.0, 0.0)
    image: str | None = None


@dataclass(frozen=True)
class Method:
    """How the image is computed, as the METHOD statement describes it; None is the default of the integrator.

    The reflection models apply to all surfaces of the scene.
    """

    adaptive: str | None = None  # "neighbours", "graded", "thesis", "variance" or "none"
    threshold: float | None = None
    cutoff: float | None = None
    fresnel: str = "exact"  # or "thesis", for conductors
    facets: str = "beckmann"  # or "gaussian", for surfaces with a slope
    phong: str = "normalized"  # or "literal", for surfaces without a material
    multiple_scattering: bool = False


@dataclass(frozen=True)
class View:
    """The camera of a scene, as its VIEW statement describes it.

    If the view plane normal ``vpn`` is (0, 0, 0), the vector ``eye`` - ``vrp`` is used as normal. The image shows the
    rectangle ``window`` (umin, vmin, umax, vmax) on the view plane, in coordinates relative to the view reference point
    ``vrp``.

    ``aperture`` is the radius of the lens, and ``focus`` the distance of the plane of focus from the eye, along the
    normal; if None, the view plane is in focus.
    """

    resolution: tuple[int, int] = (500, 500)
    window: tuple[float, float, float, float] = (-10.0, -10.0, 10.0, 10.0)
    eye: Vector = (0.0, 0.0, 20.0)
    vpn: Vector = (0.0, 0.0, 0.0)
    vrp: Vector = (0.0, 0.0, 0.0)
    vup: Vector = (0.0, 1.0, 0.0)
    aperture: float = 0.0
    focus: float | None = None


@dataclass(frozen=True)
class Operator:
    """An operator of the CSG tree: ``+``, ``-`` or ``*``. In the tree, an operator stands before its two operands."""

    symbol: str


@dataclass(frozen=True)
class Texture:
    """One of the two textures of a primitive: the name of a texture (t-...), or of an image file."""

    name: str | None = None
    image: str | None = None


@dataclass(frozen=True)
class Leaf:
    """A primitive, which is a leaf of the CSG tree: its shape, the index of its SURFACE and its TRANSFORM, its two
    textures (surface texture, solid texture), for a mesh the name of its file, and the radius of a cone's smaller disc
    or of a torus's tube.

    If named solids (SOLID) contain the primitive, ``within`` has the indices of these solids, the innermost first. In
    the scene that :func:`prosim_scene.parse` returns, ``within`` is always empty.
    """

    shape: str  # "cube", "sphere", "cylinder", "cone", "torus", "plane" or "mesh"
    index: int
    textures: tuple[Texture | None, Texture | None] = (None, None)
    within: tuple[int, ...] = ()
    file: str | None = None
    radius: float | None = None


@dataclass(frozen=True)
class Surface:
    """The optical properties in a SURFACE statement; None where the material determines the default."""

    material: str | None = None  # "conductor", "dielectric", "lambertian", "composite"; None: the classic Phong surface
    metal: str | None = None  # the name of one of Mitsuba's tables
    glass: str | None = None  # a value of the parameter material of prosim_dielectric
    ka: Vector | None = None
    kd: Vector | None = None
    ks: Vector | None = None
    eta: Vector | None = None
    k: Vector | None = None
    abbe: float | None = None  # Abbe number; used together with eta
    transmittance: Vector | None = None  # inside the solid, over the distance ``thickness``
    thickness: float = 1.0
    exponent: float | None = None  # roughness as the exponent of Phong's lobe about the mirror direction
    facet_exponent: float | None = None  # roughness as the exponent of the facets' distribution
    slope: float | None = None  # roughness as the RMS slope of Beckmann's distribution


@dataclass(frozen=True)
class Step:
    """One step of a transform: "scale" or "translate" with three values, "rotate-x", "rotate-y" or "rotate-z" with an
    angle in degrees, or "matrix" with three rows of four values.
    """

    kind: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Transform:
    """The transform of a primitive: steps, in the order in which they are applied."""

    steps: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Pattern:
    """A named texture: the kind of its pattern, and the parameters of its TEXTURE statement."""

    kind: str  # "brick", "stripes" or "fractal"
    parameters: tuple[tuple[str, float | Vector], ...] = ()


@dataclass(frozen=True)
class Scene:
    """A scene: the values of all its statements.

    ``csg`` is a flat sequence of the nodes of the CSG tree, in prefix order, so that code can process a deeply nested
    tree without recursion. The index of a leaf is the key of its SURFACE in ``surfaces`` and of its TRANSFORM in
    ``transforms``. The keys of ``patterns`` are the names of the textures. Primitives of named solids (SOLID) have new
    indices: one for each combination of the primitive's index with the index of a use of the solid.
    """

    name: str
    channels: tuple[bool, bool, bool] = (True, True, True)
    max_level: int = 3
    samples: int = 5
    shadows: bool = True
    caustics: bool = False
    air_index: float = 1.0
    ambient: Vector = (0.0, 0.0, 0.0)
    lights: tuple[Light, ...] = ()
    background: Background = Background()
    method: Method = Method()
    view: View = View()
    csg: tuple[Operator | Leaf, ...] = ()
    surfaces: dict[int, Surface] = field(default_factory=dict)
    transforms: dict[int, Transform] = field(default_factory=dict)
    patterns: dict[str, Pattern] = field(default_factory=dict)

    @cached_property
    def leaves(self) -> list[tuple[int, Leaf]]:
        """The primitives of the CSG tree, each with its position (from 0) in the sequence ``csg``."""
        return [(number, node) for number, node in enumerate(self.csg) if isinstance(node, Leaf)]
