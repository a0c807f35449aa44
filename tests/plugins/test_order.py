"""The order of lamps and of what is specular: Mitsuba gives meshes another one whenever it loads a scene."""

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import numpy as np
import pytest
from mitsuba_prosim.scene.scene_file import SceneFile

TREES = {"type": "prosim", "adaptive": "none", "samples": 2}
PATHS = TREES | {"max_level": -1, "diffuse_bounces": -1}
CAUSTICS = {"caustics": True, "caustic_photons": 2000}


def cube(x, y, size, inside):
    return f"""<shape type="cube"><transform name="to_world"><scale value="{size}"/>
        <translate x="{x}" y="{y}" z="{0.3 * x}"/></transform>{inside}</shape>"""


def lamp(k):
    return f"""<bsdf type="diffuse"/><emitter type="area">
        <rgb name="radiance" value="{1 + k % 2}, {1 + k % 3}, {2 + k}"/></emitter>"""


def glass(k):
    return f'<bsdf type="dielectric"><float name="int_ior" value="{1.3 + 0.1 * k}"/></bsdf>'


@pytest.fixture
def xml(write_scene):
    """A scene with six lamps and four pieces of glass, all of them meshes without names."""
    scene = f"""<scene version="3.0.0">
        <integrator type="path"/>
        <sensor type="perspective">
            <transform name="to_world"><lookat origin="0,4,9" target="0,0,0" up="0,1,0"/></transform>
            <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film>
        </sensor>
        <shape type="rectangle">
            <transform name="to_world"><scale value="8"/><rotate x="1" angle="-90"/></transform>
        </shape>
        <shape type="sphere"><point name="center" x="0" y="4" z="2"/><float name="radius" value="0.1"/>{lamp(3)}</shape>
        {"".join(cube(k - 2.5, 3, 0.15, lamp(k)) for k in range(6))}
        {"".join(cube(1.5 * k - 2, 0.4, 0.3, glass(k)) for k in range(4))}
    </scene>"""
    return write_scene(scene, "lamps.xml")


@pytest.mark.parametrize("integrator", [TREES | CAUSTICS, pytest.param(PATHS | CAUSTICS, marks=pytest.mark.slow)])
def test_a_scene_has_one_image_however_often_it_is_loaded(variant_rgb, xml, integrator):
    loaded = [mi.load_file(str(xml)) for _ in range(3)]  # all of them alive, and so at other addresses
    images = {np.array(mi.render(scene, integrator=mi.load_dict(integrator), seed=3)).tobytes() for scene in loaded}
    assert len(images) == 1


def test_so_has_one_that_mitsuba_s_integrator_renders(variant_rgb, xml, tmp_path):
    file = SceneFile(xml, tmp_path, integrator={"adaptive": "none", "samples": 2})
    loaded = [file.load() for _ in range(3)]
    assert len({np.array(mi.render(scene, seed=3)).tobytes() for scene in loaded}) == 1
    assert all(len(scene.emitters()) == 7 and len(scene.shapes()) == 12 for scene in loaded)


def test_meshes_of_one_material_are_merged(variant_rgb, tmp_path, write_scene):
    cubes = "".join(cube(k, 0, 0.1, glass(0)) for k in range(5)) + cube(5, 0, 0.1, lamp(0)) + cube(6, 0, 0.1, lamp(0))
    path = write_scene(f'<scene version="3.0.0">{cubes}</scene>', "cubes.xml")
    assert sorted(s.primitive_count() for s in SceneFile(path, tmp_path).load().shapes()) == [12, 12, 60]
