"""Small scenes for the tests of the integrator."""

import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def diffuse(*value):
    return {"type": "diffuse", "reflectance": rgb(*value)}


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


def sphere_lamp(center, radius, radiance):
    """A sphere that shines."""
    return {"type": "sphere", "center": center, "radius": radius, "emitter": {"type": "area", "radiance": radiance}}


def penumbra(ball=None, size=32, rfilter="box", **integrator):
    """A ball and a pole on a floor before a wall, under a spherical source."""
    T = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": integrator or {"type": "prosim"},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": T().look_at([0, 2.2, 6], [0, 0.9, 0], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": rfilter},
            },
            "sampler": {"type": "independent", "sample_count": 16},
        },
        "floor": {"type": "rectangle", "to_world": T().rotate([1, 0, 0], -90).scale(6), "bsdf": diffuse(0.6, 0.6, 0.5)},
        "wall": {"type": "rectangle", "to_world": T().translate([0, 0, -2]).scale(6), "bsdf": diffuse(0.6, 0.45, 0.4)},
        "pole": {
            "type": "cylinder",
            "p0": [-1.2, 0, 0.3],
            "p1": [-1.2, 2.4, 0.3],
            "radius": 0.12,
            "bsdf": {"type": "twosided", "bsdf": diffuse(0.3, 0.6, 0.3)},
        },
        "ball": {"type": "sphere", "center": [0.5, 0.8, 0], "radius": 0.8, "bsdf": ball or diffuse(0.2, 0.5, 0.8)},
        "light": sphere_lamp([-3, 3.5, 3], 0.5, rgb(25, 25, 25)),
    }


def alone(ball, size=32, **integrator):
    """The ball under a constant environment and the source, nothing diffuse in sight."""
    scene = penumbra(ball, size, **integrator)
    for name in ("floor", "wall", "pole"):
        del scene[name]
    scene["environment"] = {"type": "constant", "radiance": rgb(0.3, 0.4, 0.5)}
    return scene


def mesh(positions, faces, normals=None, **within):
    """A mesh with what is ``within`` it (its BSDF, its emitter), as a dictionary or loaded; by a file, as the
    constructor of ``mi.Mesh`` is another one in Mitsuba 3.10.
    """
    vertices = positions if normals is None else np.hstack([positions, normals])
    names = ("x", "y", "z", "nx", "ny", "nz")[: np.shape(vertices)[1]]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {name}" for name in names]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{value:.9g}" for value in vertex) for vertex in vertices]
    lines += [" ".join(map(str, (3, *face))) for face in faces]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mesh.ply")
        path.write_text("\n".join(lines) + "\n")
        return mi.load_dict({"type": "ply", "filename": str(path), "face_normals": False, **within})
