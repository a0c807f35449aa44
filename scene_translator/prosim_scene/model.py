"""The classes of a scene's values, which are immutable. ``language.document`` stores the position of each value in the
text.
"""

from dataclasses import dataclass, field
from functools import cached_property

Vector = tuple[float, float, float]

#: The default diffuse reflectance kd.
GREY: Vector = (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class Light:
    """A light source (section 5.2 of the thesis): a sphere, a point (whose ``radius`` is virtual), or a sky."""

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
    """The radiance of rays that leave the scene (65535 is 1.0), or the file of a latitude-longitude image."""

    color: Vector = (0.0, 0.0, 0.0)
    image: str | None = None


@dataclass(frozen=True)
class View:
    """The camera.

    A ``vpn`` of 0 0 0 means eye - vrp. ``window`` is umin, vmin, umax, vmax on the view plane, relative to ``vrp``.
    """

    resolution: tuple[int, int] = (500, 500)
    window: tuple[float, float, float, float] = (-10.0, -10.0, 10.0, 10.0)
    eye: Vector = (0.0, 0.0, 20.0)
    vpn: Vector = (0.0, 0.0, 0.0)
    vrp: Vector = (0.0, 0.0, 0.0)
    vup: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Operator:
    """An operator of the CSG tree: ``+``, ``-`` or ``*``. It stands before its two operands."""

    symbol: str


@dataclass(frozen=True)
class Texture:
    """The texture in one of the two slots of a primitive: the name of a texture (t-...) or an image file."""

    name: str | None = None
    image: str | None = None


@dataclass(frozen=True)
class Leaf:
    """A primitive, which is a leaf of the CSG tree: its shape, index, textures (surface, solid), and the file of a
    mesh.

    ``within`` is used only while the text is read: the indices of the named solids that contain the primitive, the
    innermost first.
    """

    shape: str  # "cube", "sphere", "cylinder", "cone" or "mesh"
    index: int
    textures: tuple[Texture | None, Texture | None] = (None, None)
    within: tuple[int, ...] = ()
    file: str | None = None


@dataclass(frozen=True)
class Surface:
    """The optical properties of a primitive. A missing value is None; its default depends on the material."""

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
    exponent: float | None = None  # roughness as a Phong exponent
    slope: float | None = None  # roughness as the RMS slope of Beckmann's distribution


@dataclass(frozen=True)
class Step:
    """One step of a transform: "scale" or "translate" (three values), or "rotate-x|y|z" (one value, in degrees)."""

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
    """A whole scene.

    ``csg`` is the CSG tree in prefix order, so a deeply nested tree needs no recursion. The keys of ``surfaces`` and
    ``transforms`` are the indices of the leaves. The keys of ``patterns`` are the names of textures. Each use of a part
    of a named solid has a separate index.
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
    view: View = View()
    csg: tuple[Operator | Leaf, ...] = ()
    surfaces: dict[int, Surface] = field(default_factory=dict)
    transforms: dict[int, Transform] = field(default_factory=dict)
    patterns: dict[str, Pattern] = field(default_factory=dict)

    @cached_property
    def leaves(self) -> list[tuple[int, Leaf]]:
        """The primitives of the CSG tree, each with its position in ``csg``."""
        return [(number, node) for number, node in enumerate(self.csg) if isinstance(node, Leaf)]
