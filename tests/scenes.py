"""Small scenes, and what tests do with them."""

import gc
import struct
import tempfile
import zlib
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from mitsuba_prosim.compat import EXR_THREADS

COPPER = {"type": "roughconductor", "material": "Cu", "alpha": 0.15}
#: A crop window of a film that is 40 pixels wide.
CROP = {"width": 40, "crop_offset_x": 7, "crop_offset_y": 11, "crop_width": 20, "crop_height": 9}


def T():
    """The transform that changes nothing, on which others follow."""
    return mi.ScalarTransform4f()


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def diffuse(*value):
    return {"type": "diffuse", "reflectance": rgb(*value)}


def bitmap(texels, **more):
    """A texture whose texels are raw numbers."""
    return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(np.asarray(texels, dtype=np.float32)), **more}


#: The texel of a map that changes no normal.
FLAT = np.full((2, 2, 3), (0.5, 0.5, 1.0))


def load_scene(**things):
    """A scene that is loaded."""
    return mi.load_dict({"type": "scene", **things})


def film(width, height=None, **more):
    """A film without a filter."""
    return {"type": "hdrfilm", "width": width, "height": height or width, "rfilter": {"type": "box"}, **more}


def camera(origin, target, film, up=(0, 1, 0), **more):
    """A perspective camera."""
    to_world = mi.ScalarTransform4f().look_at(origin, target, list(up))
    return {"type": "perspective", "to_world": to_world, "film": film, **more}


def area(radiance=1.0):
    """What makes a shape shine: an entry for its dictionary."""
    return {"emitter": {"type": "area", "radiance": radiance}}


def sphere_lamp(center, radius, radiance):
    """A sphere that shines."""
    return {"type": "sphere", "center": center, "radius": radius, **area(radiance)}


def rectangle(to_world, **more):
    return {"type": "rectangle", "to_world": to_world, **more}


def ground(half, bsdf, **more):
    """A square in the plane y = 0 that faces up; ``half``: half its side."""
    return rectangle(T().rotate([1, 0, 0], -90).scale(half), bsdf=bsdf, **more)


def penumbra(ball=None, size=32, rfilter="box", **integrator):
    """A ball and a pole on a floor before a wall, under a spherical source."""
    pixels = film(size, pixel_format="rgb", component_format="float32") | {"rfilter": {"type": rfilter}}
    sampler, green = {"type": "independent", "sample_count": 16}, {"type": "twosided", "bsdf": diffuse(0.3, 0.6, 0.3)}
    return {
        "type": "scene",
        "integrator": integrator or {"type": "prosim"},
        "sensor": camera([0, 2.2, 6], [0, 0.9, 0], pixels, fov=40, sampler=sampler),
        "floor": ground(6, diffuse(0.6, 0.6, 0.5)),
        "wall": rectangle(T().translate([0, 0, -2]).scale(6), bsdf=diffuse(0.6, 0.45, 0.4)),
        "pole": {"type": "cylinder", "p0": [-1.2, 0, 0.3], "p1": [-1.2, 2.4, 0.3], "radius": 0.12, "bsdf": green},
        "ball": {"type": "sphere", "center": [0.5, 0.8, 0], "radius": 0.8, "bsdf": ball or diffuse(0.2, 0.5, 0.8)},
        "light": sphere_lamp([-3, 3.5, 3], 0.5, rgb(25, 25, 25)),
    }


def loaded(ball=None, size=32, film=None, **settings):
    """That scene with the integrator prosim, unless it is another, and more settings of the film."""
    scene = penumbra(ball, size, **{"type": "prosim", **settings})
    scene["sensor"]["film"] |= film or {}
    return mi.load_dict(scene)


def without(scene, *names):
    """The scene without the things of these names."""
    return {name: thing for name, thing in scene.items() if name not in names}


def alone(ball, size=32, **integrator):
    """The ball under a constant environment and the source, nothing diffuse in sight."""
    scene = without(penumbra(ball, size, **integrator), "floor", "wall", "pole")
    return scene | {"environment": {"type": "constant", "radiance": rgb(0.3, 0.4, 0.5)}}


# ------------------------------------------------------------------ what tests do with them


def derivative(function, at=0.0):
    """Derivative of ``function``, from ``mi.Float`` to ``mi.Float``, in reverse mode."""
    x = mi.Float(at)
    dr.enable_grad(x)
    dr.backward(function(x))
    return dr.grad(x)[0]


def grid(n):
    """The midpoints of n² cells of the unit square."""
    i = dr.arange(mi.UInt32, n * n)
    return (mi.Point2f(i % n, i // n) + 0.5) / n


def uniform(n, seed=0):
    """Random numbers for ``n`` samples: one, and two of a point."""
    u = np.random.default_rng(seed).random((3, n), dtype=np.float32)
    return mi.Float(u[0]), mi.Point2f(u[1:])


def only(flags):
    """The context in which only components of these types are enabled."""
    context = mi.BSDFContext()
    context.type_mask = +flags
    return context


def slow(*values):
    """Values of a parameter with which a test is slow."""
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def in_threads(count, function, *arguments, **named):
    """What ``function`` returns where Dr.Jit has ``count`` threads."""
    before = dr.thread_count()
    try:
        dr.set_thread_count(count)
        return function(*arguments, **named)
    finally:
        dr.set_thread_count(before)


def read_exr(path):
    """The bitmap in an EXR, which Mitsuba 3.9 waits for forever where it has one thread or two."""
    return in_threads(EXR_THREADS, mi.Bitmap, str(path))


def channels(path):
    """The channels of an EXR by their names."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels, dtype=float) for name, channel in file.channels().items()}


def kernels(act):
    """The hashes of the kernels that ``act`` launches. What is compiled, and kept on the disk, does not matter."""
    gc.collect()  # kernels know of all scenes in memory
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        act()
        return {kernel["hash"] for kernel in dr.kernel_history([dr.KernelType.JIT])}


def mesh(positions, faces, **within):
    """A mesh with what is ``within`` it (its BSDF, its emitter); by a file, as the constructor of ``mi.Mesh`` is
    another one in Mitsuba 3.10.
    """
    rows = [("v", *vertex) for vertex in positions] + [("f", *(k + 1 for k in face)) for face in faces]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mesh.obj")
        path.write_text("\n".join(" ".join(map(str, row)) for row in rows))
        return mi.load_dict({"type": "obj", "filename": str(path), "face_normals": False, **within})


# ------------------------------------------------------------------ every shape of Mitsuba


def plugins_of_mitsuba(kind):
    """The names of all plugins of one kind (a ``mi.ObjectType``) that this Mitsuba has, in alphabetical order."""
    names = sorted(path.stem for path in Path(mi.__file__).with_name("plugins").glob("*.*"))
    return [name for name in names if mi.PluginManager.instance().plugin_type(name) == kind]


#: A square in the plane z = 0, whose normal is z: corners and texture coordinates.
CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
UV = CORNERS[:, :2] / 2 + 0.5
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def write_square(path, uv=UV, normals=None, color=None):
    """Writes that square as a PLY; ``color``: the attribute ``vertex_color`` of every corner."""
    mesh = mi.Mesh("square", 4, 2, has_vertex_texcoords=uv is not None, has_vertex_normals=normals is not None)
    values = {"vertex_positions": CORNERS, "faces": TRIANGLES, "vertex_texcoords": uv, "vertex_normals": normals}
    params = mi.traverse(mesh)
    for name, value in values.items():
        if value is not None:
            params[name] = np.ravel(value)
    params.update()
    if color is not None:
        mesh.add_attribute("vertex_color", 3, np.full(12, color, np.float32))
    mesh.write_ply(str(path))
    return {"type": "ply", "filename": str(path)}


def write_serialized(path):
    """Writes that square in the format of Mitsuba 0.6: version 4, single precision."""
    body = struct.pack("<I", 0x1002) + b"square\0" + struct.pack("<QQ", 4, 2)
    body += b"".join(array.tobytes() for array in (CORNERS, UV.astype(np.float32), TRIANGLES))
    path.write_bytes(struct.pack("<HH", 0x041C, 4) + zlib.compress(body) + struct.pack("<QI", 0, 1))
    return {"filename": str(path)}


#: Plugins that stand for other shapes.
COMPOUND = ("blender", "instance", "merge", "shapegroup")


def shape_of(name, folder, place=(0, 0, 0)):
    """A dictionary of the shape plugin ``name`` within 2 of ``place``, facing down, with its files in ``folder``. A
    plugin that is not known here needs no parameters.
    """
    if name.startswith("ellipsoids"):
        values = {"centers": place, "scales": [0.4, 0.2, 0.3], "quaternions": [0, 0, 0, 1]}
        return {"type": name} | {key: mi.TensorXf(np.array([value], np.float32)) for key, value in values.items()}
    to_world = T().translate(list(place)).rotate([1, 0, 0], 90)
    if name == "sdfgrid":
        axes = np.meshgrid(*[np.linspace(-0.5, 0.5, 16, dtype=np.float32)] * 3)
        distances = np.sqrt(sum(axis**2 for axis in axes))[..., None] - np.float32(0.35)
        upright = T().translate(list(place)).scale(2).translate([-0.5] * 3)  # Mitsuba 3.9 misses rotated ones
        return {"type": name, "grid": mi.TensorXf(distances), "to_world": upright}
    more = {}
    if name in ("ply", "serialized"):
        more = (write_square if name == "ply" else write_serialized)(folder / f"square.{name}")
    if name == "obj":
        rows = [("v", *v) for v in CORNERS] + [("vt", *v) for v in UV] + [("f", "1/1", "2/2", "3/3", "4/4")]
        (folder / "square.obj").write_text("\n".join(" ".join(map(str, row)) for row in rows))
        more = {"filename": str(folder / "square.obj")}
    if name in ("bsplinecurve", "linearcurve"):
        np.savetxt(folder / "curve.txt", [[-1, 0, 0, 0.3], [-0.3, 0.2, 0, 0.3], [0.4, 0, 0.2, 0.3], [1, 0, 0, 0.3]])
        more = {"filename": str(folder / "curve.txt")}
    return {**more, "type": name, "to_world": to_world}
