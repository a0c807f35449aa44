"""Translated scenes against CSG's definition, evaluated exactly along rays: see :mod:`exact_csg`."""

import re
import warnings

import drjit as dr
import exact_csg
import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from prosim_scene import SceneWarning
from prosim_scene.language import document_of
from prosim_scene.view import camera_of

EDGE = 2  # pixels that may be wrong: slivers at the ends of edges, and what single precision does to them

#: A grid of coplanar faces that look to opposite sides.
GRID = """VIEW RESOLUTION 150 100 WINDOW -3.1629 -3.5763 6.0177 3.8517 OBS -9.5353 -4.8673 -10.3788
VRP -0.1888 -0.0495 0.7888 VUP 0 1 0
LIGHTS POINT position 0 9 9
CSG-TREE - + CUBE 0 CUBE 1 CUBE 2
SURFACE 0 kd .1 TRANSFORM 0 SCALE (2 -1 2) ROTATE-Y (90) ROTATE-Z (-90) TRANSLATE (.5 1 1)
SURFACE 1 kd .2 TRANSFORM 1 SCALE (1 1 2) TRANSLATE (-.5 -2 .5)
SURFACE 2 kd .3 TRANSFORM 2 SCALE (.5 1 2) ROTATE-Z (180) TRANSLATE (.5 -1 -.5)
END
"""


def seen_by_meshes(folder):
    """A function from rays to the number of the leaf whose mesh in a folder they meet first, or -1."""
    meshes = {
        re.match(r"surface_\d+", p.stem)[0]: {"type": "ply", "filename": str(p)} for p in folder.glob("*-meshes/*.ply")
    }
    if not meshes:
        return lambda origins, directions: np.full(len(origins), -1)
    scene = mi.load_dict({"type": "scene", **meshes})
    number = {
        int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]): int(s.id().split("_")[1]) for s in scene.shapes()
    }

    def seen(origins, directions):
        ray = mi.Ray3f(mi.Point3f(origins.T), mi.Vector3f(directions.T))
        shape = np.array(dr.reinterpret_array(mi.UInt32, scene.ray_intersect_preliminary(ray, coherent=True).shape))
        return np.array([number.get(s, -1) for s in shape.tolist()])

    return seen


def wrong_pixels(text, folder):
    """How many pixels of a scene are wrong, its leaves numbered in the order of the tree."""
    path = folder / "scene.scn"
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)  # some primitives vanish
        document = document_of(text, path)
        prosim_scene.translate(path)
    return len(exact_csg.wrong_pixels(document.scene, camera_of(document), seen_by_meshes(folder)))


@pytest.mark.parametrize("kind", exact_csg.KINDS)
@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 20), marks=pytest.mark.slow)], ids=["few", "many"])
def test_what_is_seen_is_what_the_tree_means(variant_rgb, tmp_path, kind, seeds):
    wrong = {}
    for seed in seeds:
        folder = tmp_path / str(seed)
        folder.mkdir()
        wrong[seed] = wrong_pixels(exact_csg.KINDS[kind](np.random.default_rng([seed, 99])), folder)
    assert not {seed: count for seed, count in wrong.items() if count > EDGE}


def test_faces_of_a_grid_that_look_to_opposite_sides(variant_rgb, tmp_path):
    assert wrong_pixels(GRID, tmp_path) <= EDGE


def test_the_judge_finds_a_primitive_in_the_wrong_place(variant_rgb, tmp_path):
    # Seen are the meshes of another tree: a judge that lets this pass would let anything pass.
    path = tmp_path / "scene.scn"
    path.write_text(GRID.replace("- + CUBE 0 CUBE 1 CUBE 2", "+ CUBE 0 CUBE 1"))
    with pytest.warns(SceneWarning, match="no primitive has this index"):
        prosim_scene.translate(path)
    document = document_of(GRID, path)
    assert len(exact_csg.wrong_pixels(document.scene, camera_of(document), seen_by_meshes(tmp_path))) > 50
