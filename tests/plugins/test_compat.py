"""Whatever Mitsuba calls and returns, in the version that is installed or the next one, the image is the same.

The next one is imitated: its transforms have ``eval`` alone, the names of parameters are its own, and meshes have
tensors.
"""

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_prosim import compat
from mitsuba_prosim.light.strategy import SphereLights
from scenes import load_scene, mesh, penumbra

#: Parameters of Mitsuba 3.9 -> those of 3.10.
RENAMED = {"to_world": "to_world.transform", "vertex_positions": "positions"}


class Animated:
    """A ``mi.AnimatedTransform4f`` of Mitsuba 3.10 with one keyframe: no matrix, no ``@``."""

    def __init__(self, transform):
        self._transform = transform

    def eval(self, time):
        return self._transform


class Parameters:
    """The parameters of an object under their names of 3.10; there are none of 3.9."""

    def __init__(self, parameters):
        self._parameters, self.hierarchy = parameters, parameters.hierarchy
        self._names = {self._new(name): name for name in dict.fromkeys(parameters.keys())}

    @staticmethod
    def _new(name):
        before, _, last = name.rpartition(".")
        return f"{before}." * bool(before) + RENAMED.get(last, last)

    def __contains__(self, name):
        return name in self._names

    def __getitem__(self, name):
        value = self._parameters[self._names[name]]
        return mi.TensorXf(value, (len(value) // 3, 3)) if name.endswith("positions") else value

    def __setitem__(self, name, value):
        self._parameters[self._names[name]] = value

    def keys(self):
        return self._names.keys()

    def update(self, *args):
        return self._parameters.update(*args)


@pytest.fixture
def next_mitsuba(variant_rgb, monkeypatch):
    """Puts the interface of Mitsuba 3.10 over that of 3.9."""
    sensor, traverse = mi.Sensor.world_transform, mi.traverse

    def put():
        monkeypatch.setattr(mi.Endpoint, "world_transform", lambda self: Animated(sensor(self)))
        monkeypatch.setattr(mi, "traverse", lambda node: Parameters(traverse(node)))

    return put


def window():
    """A scene through our own sensor, with photons off a mesh of glass."""
    scene = penumbra(size=8, type="prosim", caustics=True, caustic_photons=2000, samples=2)
    scene["sensor"] |= {"type": "prosim_window"}
    del scene["sensor"]["fov"]
    corners = [[0.5, 0.3, 1], [1, 0.3, 1.5], [0.5, 0.3, 2], [0, 0.3, 1.5]]
    scene["pane"] = mesh(corners, [(0, 1, 2), (0, 2, 3)], bsdf={"type": "dielectric"})
    return scene


@pytest.mark.parametrize("scene", [penumbra, window])
def test_the_image_is_the_same(next_mitsuba, scene):
    scenes = [mi.load_dict(scene(size=8) if scene is penumbra else scene()) for _ in range(2)]
    before = np.array(mi.render(scenes[0]))
    next_mitsuba()
    assert np.array_equal(np.array(mi.render(scenes[1])), before) and before.any()


@pytest.mark.parametrize("kind, turn", [("sphere", 120), ("sphere", 30), ("cylinder", 0)])
def test_turned_and_mirrored_shape_has_its_normals(next_mitsuba, kind, turn):
    """Otherwise its samples would lose light."""
    to_world = mi.ScalarTransform4f().rotate([1, 0, 0], turn).scale([-1, 1, 1] if kind == "cylinder" else 2)
    shape = mi.load_dict({"type": kind, "to_world": to_world})
    ps = shape.sample_position(0.0, mi.Point2f(0.3, 0.6))

    def known():
        return [*np.ravel(compat.outer_normal(shape, ps.p, ps.n)), *compat.linear_part(shape).ravel()]

    before, unique = known(), compat.has_unique_uv(shape)
    assert not np.allclose(before[:3], np.ravel(ps.n)) and unique == (turn == 30)
    next_mitsuba()
    assert known() == before and compat.has_unique_uv(shape) == unique


@pytest.mark.parametrize("kind", ["perspective", "prosim_window"])
def test_a_sensor_is_moved(next_mitsuba, kind):
    sensor = mi.load_dict({"type": kind})
    next_mitsuba()
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    parameters = mi.traverse(sensor)
    compat.set_world_transform(sensor, parameters, matrix)
    parameters.update()
    assert np.array_equal(compat.world_matrix(sensor), matrix)
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    assert np.ravel(ray.o)[:2] == pytest.approx([1, 2])


def test_class_names_are_those_of_mitsubas_plugins(variant_rgb):
    """Of this Mitsuba: a kind whose name changes would lose its special treatment silently."""
    bsdf, group = {"type": "diffuse"}, {"type": "shapegroup", "shape": {"type": "cube"}}
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(np.ones((2, 2, 3), np.float32)), "raw": True}
    classes = {
        compat.SPHERE: {"type": "sphere"},
        compat.CYLINDER: {"type": "cylinder"},
        compat.RECTANGLE: {"type": "rectangle"},
        compat.PERSPECTIVE: {"type": "perspective"},
        compat.ENVMAP: {"type": "envmap", "bitmap": mi.Bitmap(np.ones((4, 8, 3), np.float32))},
        compat.CONSTANT: {"type": "constant"},
        compat.MASK: {"type": "mask", "bsdf": bsdf},
        compat.BLEND: {"type": "blendbsdf", "a": bsdf, "b": {"type": "plastic"}, "weight": 0.5},
        compat.TWO_SIDED: {"type": "twosided", "bsdf": bsdf},
        compat.MAPS[0]: {"type": "bumpmap", "texture": texture, "bsdf": bsdf},
        compat.MAPS[1]: {"type": "normalmap", "normalmap": texture, "bsdf": bsdf},
        compat.ROUGH_PLASTIC: {"type": "roughplastic"},
        compat.CHOOSERS[0]: {"type": "plastic"},
        compat.CHOOSERS[1]: {"type": "thindielectric"},
        compat.EVALUATED_TOGETHER[0]: {"type": "principled"},
        compat.EVALUATED_TOGETHER[1]: {"type": "principledthin"},
        compat.AOV: {"type": "aov", "aovs": "d:depth"},
        compat.PATH: {"type": "path"},
    }
    assert {name: mi.load_dict(plugin).class_name() for name, plugin in classes.items()} == {n: n for n in classes}
    ball = mi.load_dict({"type": "sphere", "emitter": {"type": "directionalarea"}})  # keeps its emitter's shape alive
    instance = load_scene(group=group, i={"type": "instance", "g": {"type": "ref", "id": "group"}})
    assert not SphereLights.can_sample(ball.emitter())
    assert [shape.class_name() for shape in instance.shapes()] == [compat.INSTANCE]
