"""The scene as typed, immutable values. ``language.document`` has their spans in the text."""

import html
from dataclasses import dataclass, field
from functools import cached_property

Vector = tuple[float, float, float]

#: The default of kd.
GREY: Vector = (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class Light:
    """A light source (section 5.2 of the thesis): a sphere, or a point whose ``radius`` is virtual."""

    kind: str  # "area" or "point"; or "sky": an environment image; of the other values only ``image`` is used
    position: Vector = (0.0, 0.0, 0.0)
    intensity: Vector = (65535.0, 65535.0, 65535.0)  # 65535 is 1.0
    radius: float = 1.0
    distribution: str = "uniform"  # or "cone", "spot"
    direction: Vector = (0.0, -1.0, 0.0)
    angle: float | None = None  # degrees: half-opening of a cone, cut-off of a spot
    exponent: float = 1.0  # of a spot
    image: str | None = None  # of a sky, latitude by longitude


@dataclass(frozen=True)
class Background:
    """Radiance of a ray that leaves the scene: 65535 is 1.0; or an image, latitude by longitude."""

    color: Vector = (0.0, 0.0, 0.0)
    image: str | None = None


@dataclass(frozen=True)
class View:
    """The camera. ``vpn`` 0 0 0 means eye - vrp; ``window`` is umin, vmin, umax, vmax on the plane, relative to vrp."""

    resolution: tuple[int, int] = (500, 500)
    window: tuple[float, float, float, float] = (-10.0, -10.0, 10.0, 10.0)
    eye: Vector = (0.0, 0.0, 20.0)
    vpn: Vector = (0.0, 0.0, 0.0)
    vrp: Vector = (0.0, 0.0, 0.0)
    vup: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Operator:
    """``+``, ``-`` or ``*``, before its two operands."""

    symbol: str


@dataclass(frozen=True)
class Texture:
    """The texture in one of a primitive's two slots: a name (t-...) or an image file."""

    name: str | None = None
    image: str | None = None


@dataclass(frozen=True)
class Leaf:
    """A primitive in the tree: its shape, its index, its textures (surface, solid), and a mesh's file.

    ``within``: while the text is read, the indices of the named solids that it is a part of, the innermost first.
    """

    shape: str  # "cube", "sphere", "cylinder", "cone" or "mesh"
    index: int
    textures: tuple[Texture | None, Texture | None] = (None, None)
    within: tuple[int, ...] = ()
    file: str | None = None


@dataclass(frozen=True)
class Surface:
    """The optics of a primitive. Missing values are None; their defaults depend on the material."""

    material: str | None = None  # "conductor", "dielectric", "lambertian", "composite"; None: the classic Phong surface
    metal: str | None = None  # one of Mitsuba's tables
    glass: str | None = None  # one of prosim_dielectric's materials
    ka: Vector | None = None
    kd: Vector | None = None
    ks: Vector | None = None
    eta: Vector | None = None
    k: Vector | None = None
    abbe: float | None = None  # Abbe number, beside eta
    transmittance: Vector | None = None  # of the inside, over the distance ``thickness``
    thickness: float = 1.0
    exponent: float | None = None  # roughness as a Phong exponent ...
    slope: float | None = None  # ... or as the RMS slope of Beckmann's distribution; neither: ideally smooth


@dataclass(frozen=True)
class Step:
    """One step of a transform: "scale", "translate" (three values) or "rotate-x|y|z" (degrees)."""

    kind: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Transform:
    """The place of a primitive: steps, in the order in which they are applied."""

    steps: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Pattern:
    """A named texture: the kind of its pattern, and the parameters of its TEXTURE statement."""

    kind: str  # "brick", "stripes" or "fractal"
    parameters: tuple[tuple[str, float | Vector], ...] = ()


@dataclass(frozen=True)
class Scene:
    """A whole scene.

    ``csg`` is the tree in prefix order, so that no depth of nesting needs recursion; the keys of ``surfaces`` and
    ``transforms`` are the indices of the leaves, those of ``patterns`` the names of textures. Each use of a part of a
    named solid has a separate index. ``text`` is the text of the scene.
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
    text: str = field(default="", compare=False, repr=False)

    @cached_property
    def leaves(self) -> list[tuple[int, Leaf]]:
        """The primitives of the tree, each with its number in ``csg``."""
        return [(number, node) for number, node in enumerate(self.csg) if isinstance(node, Leaf)]

    def _repr_html_(self) -> str:
        """The text of the scene, for notebooks."""
        return f"<pre>{html.escape(self.text or repr(self))}</pre>"
