"""What a translation leaves to the next one."""

import numpy as np
import prosim_scene
import pytest

SCENE = """DEFAULT $turn = 0
DEFAULT $red = 0.1
DEFAULT $size = 1
DEFAULT $blue = 0.5
VIEW OBS {15 * sin($turn)} 0 {15 * cos($turn)} WINDOW -4 -4 4 4
LIGHTS POINT position 5 5 9
CSG-TREE - + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2
SURFACE 0 kd = $red 0.5 0.5
SURFACE 1 kd = $blue 0.5 0.5
SURFACE 2 material condutor ouro
TRANSFORM 0 TRANSLATE (-.5 -.5 -.5) SCALE (2 2 2)
TRANSFORM 1 SCALE ($size $size 1.3)
TRANSFORM 2 SCALE (.4 .4 9) TRANSLATE (0 0 -4)
END
"""


def files(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}


# what is told to the second and third translation, and how many trees are evaluated in all
@pytest.mark.parametrize(
    "second, third, made",
    [
        ({"turn": 30, "red": 0.7}, {"turn": 70}, 1),
        ({"blue": 0.1}, {"red": 0.5}, 1),
        ({"size": 1.1}, {"size": 1.1, "turn": 20}, 2),
        ({"size": 1.1}, {"size": 1}, 3),
    ],
)
def test_the_same_solids_are_evaluated_once_and_the_files_are_the_same(tmp_path, write_scene, second, third, made):
    path, cache = write_scene(SCENE), prosim_scene.TranslationCache()
    for define in {}, second, third:
        prosim_scene.translate(prosim_scene.document(path, define), tmp_path / "kept", cache=cache)
        prosim_scene.translate(path, tmp_path / "anew", define=define)
        assert files(tmp_path / "kept") == files(tmp_path / "anew") and len(files(tmp_path / "kept")) == 4
    assert cache.evaluations == made


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("options", [{"resolution": (20, 10), "samples": 7}, {"target": "stock"}])
def test_another_view_needs_no_translation(tmp_path, options):
    """Also where the eye is so near to a face that it would be cut off."""
    path, cache = tmp_path / "s.scn", prosim_scene.TranslationCache()
    path.write_text(cube := SCENE.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "CUBE 0"))
    prosim_scene.translate(path, cache=cache, **options)
    path.write_text(cube.replace("WINDOW -4 -4 4 4", "WINDOW -4 -3 4 4").replace("15 *", "1.0001 *"))
    document = prosim_scene.document(path, {"turn": 90})
    view = prosim_scene.sensor(document, cache, **options)
    np.testing.assert_equal(view, prosim_scene.load(document, **options)["view"])
    assert view["near_clip"] < prosim_scene.sensor(document, **options)["near_clip"]
    path.write_text(cube.replace("-4 -4 4 4", "-4 4 4 4"))
    document = prosim_scene.document(path)
    with pytest.raises(prosim_scene.SceneError, match="the window -4 4 4 4 is empty"):
        prosim_scene.sensor(document, cache, **options)


def test_what_vanishes_is_said_each_time(tmp_path, write_scene):
    cache = prosim_scene.TranslationCache()
    vanishing = SCENE.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "+ CUBE 0 + SPHERE 1 SPHERE 2")
    path = write_scene(vanishing.replace("SCALE (.4 .4 9) TRANSLATE (0 0 -4)", "SCALE (.4 .4 .4)"))
    for turn in (0, 20):
        with pytest.warns(prosim_scene.SceneWarning, match="nothing is visible of SPHERE 2"):
            prosim_scene.translate(path, tmp_path / "kept", define={"turn": turn}, cache=cache)
    assert cache.evaluations == 1
