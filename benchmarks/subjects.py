"""The scenes of the benchmarks: the project's examples, scenes built here, and scenes by other authors.

A :class:`Subject` is a scene without an integrator, and the parameters of the thesis's integrator for this scene.
Scenes by other authors are not shipped: the user names a folder that contains them as ``FOLDER/NAME/scene.xml``. The
page docs/calibration.md names the sources of the scenes that were measured.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import prosim_scene
from mitsuba_prosim.scene.overrides import CROP

EXAMPLES = Path(__file__).parents[1] / "examples"
OURS = ("palito", "aranha", "chao-rugoso", "penumbra", "fontes", "esfera-metalica", "poste", "chimarrao", "caustica")
#: Maximum number of edges of a light path.
DEPTH = 8


def rgb(*values: float) -> dict[str, Any]:
    """Returns a colour; a single value is used for all three channels."""
    return {"type": "rgb", "value": list(values) * (3 if len(values) == 1 else 1)}


def diffuse(*values: float) -> dict[str, Any]:
    """Returns a diffuse material."""
    return {"type": "diffuse", "reflectance": rgb(*values)}


def sphere(center: list[float], radius: float, **look: Any) -> dict[str, Any]:
    """Returns a sphere with a ``bsdf`` or an ``emitter``."""
    return {"type": "sphere", "center": center, "radius": radius, **look}


def lamp(center: list[float], radius: float, radiance: float) -> dict[str, Any]:
    """Returns a spherical lamp."""
    return sphere(center, radius, emitter={"type": "area", "radiance": rgb(radiance)})


def rectangle(bsdf: dict[str, Any], transform: Callable[[Any], Any]) -> dict[str, Any]:
    """Returns a rectangle; ``transform`` is a function from the identity to the rectangle's transform."""
    return {"type": "rectangle", "to_world": transform(mi.ScalarTransform4f()), "bsdf": bsdf}


def stage(**things: Any) -> dict[str, Any]:
    """Returns a floor, a wall, a pole, a ball and a lamp, seen from the front; ``things`` replace or add objects."""
    look_at = mi.ScalarTransform4f().look_at([0, 2.2, 6], [0, 0.9, 0], [0, 1, 0])
    return {
        "sensor": {"type": "perspective", "fov": 40, "to_world": look_at},
        "floor": rectangle(diffuse(0.6, 0.6, 0.5), lambda t: t.rotate([1, 0, 0], -90).scale(6)),
        "wall": rectangle(diffuse(0.6, 0.45, 0.4), lambda t: t.translate([0, 0, -2]).scale(6)),
        "pole": {
            "type": "cylinder",
            "p0": [-1.2, 0, 0.3],
            "p1": [-1.2, 2.4, 0.3],
            "radius": 0.12,
            "bsdf": {"type": "twosided", "bsdf": diffuse(0.3, 0.6, 0.3)},
        },
        "ball": sphere([0.5, 0.8, 0], 0.8, bsdf=diffuse(0.2, 0.5, 0.8)),
        "lamp": lamp([-3, 3.5, 3], 0.5, 75.0),
    } | things


def copper(alpha: float, material: str = "Cu") -> dict[str, Any]:
    """Returns a rough metal, by Mitsuba's own plugin."""
    return {"type": "roughconductor", "material": material, "alpha": alpha}


def metal_floor(alpha: float) -> dict[str, Any]:
    """Returns diffuse balls above a metal floor, under a lamp and a dim sky (figures 5.3 to 5.5 of the thesis)."""
    return stage(
        floor=rectangle(copper(alpha), lambda t: t.rotate([1, 0, 0], -90).scale(10)),
        wall=sphere([-1.1, 0.7, 0], 0.7, bsdf=diffuse(0.8, 0.2, 0.15)),
        pole=sphere([0.4, 0.35, 1.2], 0.35, bsdf=diffuse(0.2, 0.7, 0.2)),
        sky={"type": "constant", "radiance": rgb(0.3, 0.36, 0.5)},
    )


def lamps(count: int) -> dict[str, Any]:
    """Returns the stage with ``count`` small lamps of very different power."""
    row = range(count)
    many = {
        f"lamp{i}": lamp([-3 + 6 * (i % 6) / 5, 3.2, 3 - 1.2 * (i // 6)], 0.12, 8.0 * (1 + i % 5) ** 2) for i in row
    }
    scene = stage(**many)
    del scene["lamp"]
    return scene


def cornell_box() -> dict[str, Any]:
    """Returns Mitsuba's Cornell box."""
    return {name: value for name, value in mi.cornell_box().items() if name not in ("type", "integrator")}


def gold_and_glass() -> dict[str, Any]:
    """Returns the stage with a ball of rough gold and a ball of glass."""
    glass = {"type": "dielectric", "int_ior": 1.5}
    gold = sphere([-0.6, 0.8, 0], 0.8, bsdf=copper(0.15, "Au"))
    return stage(pole=gold, ball=sphere([1.1, 0.7, 0.5], 0.7, bsdf=glass))


#: Name of a scene built here -> the function that builds it, and the parameters of ``prosim`` for which its tree of
#: rays follows all light. None: only a path tracer follows all light.
BUILT: dict[str, tuple[Callable[[], dict[str, Any]], dict[str, Any] | None]] = {
    "stage": (stage, {"max_level": 0}),
    "copper ball": (lambda: stage(ball=sphere([0.5, 0.8, 0], 0.8, bsdf=copper(0.15))), {"max_level": 0}),
    "metal floor": (lambda: metal_floor(0.1), {"max_level": 0}),
    "24 lamps": (lambda: lamps(24), {"max_level": 0}),
    "Cornell box": (cornell_box, None),
    "gold and glass": (gold_and_glass, None),
}
NAMES = (*OURS, *BUILT)


@dataclass(frozen=True)
class Subject:
    """A scene of :data:`NAMES` or of a ``folder``, rendered with a width of ``size`` pixels; ``rfilter`` is the film's
    filter, but not of an example scene.
    """

    name: str
    size: int = 256
    folder: Path | None = None
    rfilter: str = "box"

    @cached_property
    def described(self) -> tuple[dict[str, Any], dict[str, Any] | None]:
        """``(scene, integrator)`` as dictionaries; the integrator is None if only a path tracer follows all light."""
        if self.name in BUILT:
            make, tree = BUILT[self.name]
            film = {"width": self.size, "height": self.size, "rfilter": {"type": self.rfilter}}
            return with_film(make(), film), tree and {"type": "prosim"} | tree
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = prosim_scene.load(EXAMPLES / f"{self.name}.scn", resolution=(self.size, self.size))
        return scene, scene.pop("integrator")

    @property
    def external(self) -> Path | None:
        """The file of a scene by other authors; None for the project's own scenes."""
        if self.name in NAMES:
            return None
        if self.folder is None:
            raise SystemExit(f"{self.name} is a scene by others: name the folder that has it with --folder.")
        return self.folder / self.name / "scene.xml"

    @property
    def tree(self) -> dict[str, Any] | None:
        """The thesis's integrator for the scene; None if only a path tracer follows all light."""
        return None if self.external else self.described[1]

    @property
    def adaptive(self) -> dict[str, Any]:
        """Mitsuba's path tracer for the scene, nested in ``prosim_adaptive``."""
        media = self.external and "<medium" in self.external.read_text(encoding="utf-8")
        return {"type": "prosim_adaptive", "nested": {"type": "volpath" if media else "path", "max_depth": DEPTH}}

    def load(self, sampler: str = "independent") -> mi.Scene:
        """Loads the scene; its sensor has this ``sampler``."""
        if self.external:
            return self._external(self.external, sampler)
        scene = self.described[0] | {"integrator": self.tree or self.adaptive["nested"]}
        for name, value in scene.items():
            if isinstance(value, dict) and "film" in value:
                scene[name] = value | {"sampler": {"type": sampler}}
        return mi.load_dict({"type": "scene"} | scene)

    def _external(self, path: Path, sampler: str) -> mi.Scene:
        """Loads a scene by other authors, with the requested width, filter and sampler, and without a crop window."""
        config = mi.parser.ParserConfig(mi.variant())
        mi.file_resolver().prepend(str(path.parent.resolve()))
        state = mi.parser.parse_file(config, str(path))
        for node in state.nodes:
            props = node.props
            if node.type == mi.ObjectType.Film:
                height = round(self.size * props.get("height", 576) / props.get("width", 768))
                props["width"], props["height"] = self.size, height
                for name in CROP:
                    if name in props:
                        del props[name]
                if not any(other.type == mi.ObjectType.ReconstructionFilter for other in state.nodes):
                    props["rfilter"] = mi.load_dict({"type": self.rfilter})
            elif node.type == mi.ObjectType.Integrator:
                # The integrator that the file names may not be installed.
                node.props = mi.Properties(self.adaptive["nested"]["type"])
                node.props["max_depth"] = DEPTH
            elif node.type == mi.ObjectType.Sampler:
                props.set_plugin_name(sampler)
            elif node.type == mi.ObjectType.ReconstructionFilter:
                props.set_plugin_name(self.rfilter)
        mi.parser.transform_all(config, state)
        return mi.parser.instantiate(config, state)


def with_film(scene: dict[str, Any], film: dict[str, Any]) -> dict[str, Any]:
    """Returns ``scene`` with a film on its sensor; the film has a box filter."""
    film = {"type": "hdrfilm", "pixel_format": "rgb", "rfilter": {"type": "box"}} | film
    return scene | {"sensor": scene["sensor"] | {"film": film}}
