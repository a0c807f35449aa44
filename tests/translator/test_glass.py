"""What a dieletrico is made of: glasses by name, Abbe numbers, and what it absorbs."""

import math

import mitsuba as mi
import numpy as np
import prosim_scene
import pytest
from mitsuba_prosim.optics.dispersion import MATERIALS, D, Dispersion
from prosim_scene import SceneWarning
from prosim_scene.language.words import GLASSES, INDICES


@pytest.fixture
def glass(write_scene):
    def write(surface, tree="SPHERE 0", more="", view="WINDOW -.1 -.1 .1 .1 OBS 0 0 9"):
        return write_scene(f"""
        AMBIENT 65535 65535 65535  BACKGROUND 65535 65535 65535  MAX-LEVEL 6
        LIGHTS AREA position 0 50 0  VIEW RESOLUTION 9 9 {view}
        CSG-TREE {tree}
        SURFACE 0 material dieletrico {surface}
        TRANSFORM 0 SCALE (1 1 1)
        {more}
        END
        """)

    return write


def ball(path, **options):
    return prosim_scene.load(path, **options)["surface_0"]


def test_names_of_glasses_are_those_of_the_plugin(variant_rgb):
    assert set(GLASSES.values()) == set(MATERIALS) == set(INDICES)
    for name, n in INDICES.items():
        assert n == pytest.approx(Dispersion.of(False, MATERIALS[name]).index(D)[0], abs=1e-5)


def test_glass_is_said_by_name_or_abbe_number(glass):
    named = ball(glass("Diamante m = .2"))["bsdf"]
    assert named["int_material"] == "diamond" and "int_ior" not in named and named["alpha"] == 0.2
    given = ball(glass("n-refr = 1.62 abbe = 36.4"))["bsdf"]
    assert (given["int_ior"], given["int_abbe"]) == (pytest.approx(1.62), 36.4)
    with pytest.warns(SceneWarning, match="one index for all wavelengths"):
        assert ball(glass("agua"), target="stock")["bsdf"]["int_ior"] == INDICES["water"]


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
def test_what_is_left_after_a_thickness(glass):
    path = glass("n-refr = 1.5 transmitancia = .25 1 .5 espessura = 2")
    for target in ("prosim", "stock"):
        loaded = prosim_scene.load(path, target=target)
        medium = loaded["surface_0"]["interior"]
        sigma = np.array(medium["sigma_t"]["value"]) * medium["scale"]
        assert medium["albedo"] == 0 and np.exp(-2 * sigma) == pytest.approx([0.25, 1, 0.5])
        assert min(sigma) > 0  # or volpath would give no number
        assert loaded["integrator"]["type"] == {"prosim": "prosim", "stock": "volpath"}[target]
    assert "interior" not in ball(glass("n-refr = 1.5 transmitancia = 1"))


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize(
    "tree, view, length",
    [
        ("SPHERE 0", "WINDOW -.01 -.01 .01 .01 OBS 0 0 9", 2),
        ("- SPHERE 0 SPHERE 1", "WINDOW -.01 -.01 .01 .01 OBS 0 0 9", 1.2),  # hollow: faces that were cut are turned
        ("SPHERE 0", "WINDOW -.01 -.01 .01 .01 OBS 0 0 .5", 1.5),  # the eye within
        ("+ SPHERE 0 CYLINDER 2", "WINDOW -.01 -.01 .01 .01 OBS 0 0 9", 1),  # half of it behind a white card
    ],
    ids=["ball", "hollow ball", "eye within", "card within"],
)
def test_ball_absorbs_by_its_thickness(variant_rgb, tmp_path, glass, tree, view, length):
    """Of index 1, it is seen by nothing but its colour; from XML, as the commands read it."""
    more = """
        SURFACE 1 material dieletrico n-refr = 1 transmitancia .25 1 .5 TRANSFORM 1 SCALE (.4 .4 .4)
        SURFACE 2 material lambertiano kd = 0 ka = 1 TRANSFORM 2 SCALE (.2 .2 .5) ROTATE-X (180)
    """
    path = glass("n-refr = 1 transmitancia .25 1 .5", tree, more, view)
    xml = prosim_scene.translate(path, tmp_path / "out")
    image = np.array(mi.render(mi.load_file(str(xml), parallel=False)))
    assert image[4, 4] == pytest.approx(np.array([0.25, 1, 0.5]) ** length, abs=1e-3)
    assert math.isclose(image[..., 1].min(), 1, abs_tol=1e-4)
