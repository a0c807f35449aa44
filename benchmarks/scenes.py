"""The scenes of the benchmarks.

Each is made from Mitsuba's own plugins where it can be, so that integrators and samplers are compared, not materials;
most have a mean near a quarter of white.
"""

import tempfile
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np
from mitsuba_prosim.compare.scenes import FileScene, Scene
from mitsuba_prosim.scene.scene_file import SceneFile

PALITO = Path(__file__).parents[1] / "examples" / "palito.scn"


def rgb(*values):
    return {"type": "rgb", "value": list(values)}


def diffuse(*values):
    return {"type": "diffuse", "reflectance": rgb(*values)}


def floor(bsdf, size=6):
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(size), "bsdf": bsdf}


def ball(center, radius, bsdf):
    return {"type": "sphere", "center": center, "radius": radius, "bsdf": bsdf}


def lamp(center, radius, radiance):
    return {
        "type": "sphere",
        "center": center,
        "radius": radius,
        "emitter": {"type": "area", "radiance": rgb(*[radiance] * 3)},
    }


def camera(origin, target, fov):
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0]),
    }


def stage(**things):
    """A floor and a wall, seen from the front, and a lamp before them."""
    return {
        "sensor": camera([0, 2.2, 6], [0, 0.9, 0], 40),
        "floor": floor(diffuse(0.6, 0.6, 0.5)),
        "wall": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(6),
            "bsdf": diffuse(0.6, 0.45, 0.4),
        },
        "lamp": lamp([-3, 3.5, 3], 0.5, 75.0),
    } | things


def pole():
    return {
        "type": "cylinder",
        "p0": [-1.2, 0, 0.3],
        "p1": [-1.2, 2.4, 0.3],
        "radius": 0.12,
        "bsdf": {"type": "twosided", "bsdf": diffuse(0.3, 0.6, 0.3)},
    }


def copper(alpha):
    return {"type": "roughconductor", "material": "Cu", "alpha": alpha}


def penumbra():
    """A diffuse ball and a pole, whose shadows are soft, on a diffuse floor."""
    return stage(pole=pole(), ball=ball([0.5, 0.8, 0], 0.8, diffuse(0.2, 0.5, 0.8)))


def copper_ball():
    """The same with a ball of rough copper, which mirrors the lamp."""
    return stage(pole=pole(), ball=ball([0.5, 0.8, 0], 0.8, copper(0.15)))


def rough_floor(alpha):
    """Balls above a metal floor (figures 5.3 to 5.5: the same floor at three roughnesses)."""
    return {
        "sensor": camera([0, 2.0, 6], [0, 0.6, 0], 38),
        "floor": floor(copper(alpha), 10),
        "lamp": lamp([-3, 4, 2], 0.6, 50.0),
        "sky": {"type": "constant", "radiance": rgb(0.3, 0.36, 0.5)},
        "red": ball([-1.1, 0.7, 0], 0.7, diffuse(0.8, 0.2, 0.15)),
        "blue": ball([0.8, 0.9, -0.6], 0.9, diffuse(0.2, 0.3, 0.8)),
        "green": ball([0.4, 0.35, 1.2], 0.35, diffuse(0.2, 0.7, 0.2)),
    }


def many_lights():
    """Sixteen small lamps over the diffuse scene."""
    lamps = {f"lamp_{i}": lamp([-3 + 2 * (i % 4), 3.2, 3.5 - 1.2 * (i // 4)], 0.15, 33.0) for i in range(16)}
    scene = stage(pole=pole(), ball=ball([0.5, 0.8, 0], 0.8, diffuse(0.2, 0.5, 0.8)))
    del scene["lamp"]
    return scene | lamps


def glass():
    """Smooth glass balls, one in another, under a sky with dark bars: reflection and refraction at every level."""
    v, u = np.mgrid[0:128, 0:256] / np.array([128, 256]).reshape(2, 1, 1)
    sky = (0.08 + 0.25 * ((u * 16) % 1 < 0.5) * (v < 0.7) + 0.1 * v)[..., None] * np.array([0.9, 1.0, 1.1])
    glass = {"type": "dielectric", "int_ior": 1.5}
    return {
        "sensor": camera([0, 0.6, 6], [0, 0, 0], 38),
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype(np.float32))},
        "big": ball([-0.7, 0, 0], 1.2, glass),
        "hollow": ball([-0.7, 0, 0], 1.0, {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}),
        "small": ball([1.3, -0.3, 0.6], 0.8, glass),
    }


def cornell_box():
    """Mitsuba's Cornell box, with all its interreflection."""
    scene = mi.cornell_box()
    return {name: value for name, value in scene.items() if name not in ("type", "integrator")}


class BuiltScene(Scene):
    """A scene of a dictionary, ``size`` pixels wide and high; ``settings`` as for every :class:`Scene`."""

    def __init__(self, make, size, settings):
        super().__init__(settings, f"{make()} {settings} {size} {mi.variant()} {mi.__version__}")
        self.make, self.size = make, size

    def load(self, sampler):
        scene = self.make()
        scene["sensor"] = scene["sensor"] | {
            "film": {
                "type": "hdrfilm",
                "width": self.size,
                "height": self.size,
                "pixel_format": "rgb",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": sampler or "independent"},
        }
        return mi.load_dict({"type": "scene"} | scene)


@dataclass
class Case:
    """What is rendered and by whom. ``ours``, ``theirs``: parameters in the same transport."""

    make: object
    ours: dict = field(default_factory=dict)
    theirs: dict = field(default_factory=lambda: {"direct": {}})
    #: Transports of ours and of theirs.
    transports: tuple = ("scene", "scene")

    def open(self, size, folder):
        if self.make is PALITO:
            return FileScene(SceneFile(flat_palito(folder), folder, resolution=(size, size)))
        return BuiltScene(self.make, size, {"prosim": self.ours, **self.theirs})

    @property
    def same_light(self):
        return self.transports[0] == self.transports[1]


def flat_palito(folder):
    """The scene palito without its textures, as other renderers have been timed on it."""
    text = PALITO.read_text()
    for texture in ("t-tijolo", "t-listra", "t-fractal"):
        text = text.replace(texture, "NULL")
    path = Path(tempfile.mkdtemp(dir=folder)) / "palito.scn"
    path.write_text(text)
    warnings.simplefilter("ignore")
    return path


DIRECT = {"max_level": 0}
PATHS = {"max_level": -1, "diffuse_bounces": -1}

SCENES = {
    "penumbra": Case(penumbra, DIRECT),
    "copper": Case(copper_ball, DIRECT),
    "many_lights": Case(many_lights, DIRECT),
    "floor_smooth": Case(lambda: rough_floor(0.02), DIRECT),
    "floor_rough": Case(lambda: rough_floor(0.1), DIRECT),
    "floor_rougher": Case(lambda: rough_floor(0.3), DIRECT),
    "glass": Case(glass, {"max_level": 5}, {"path": {"max_depth": 7, "rr_depth": 100}}),
    "cornell_box": Case(cornell_box, PATHS | {"max_level": 6}, {"path": {"max_depth": 8}}),
    "palito": Case(PALITO, {}, {"path": {}}, ("scene", "paths")),
    "palito_paths": Case(PALITO, {}, {"path": {}}, ("paths", "paths")),
}
