"""The files of a translation: what it overwrites and removes, what it never touches, and what it leaves to the next."""

import copy
import errno
import gc
import os
import re
import subprocess
import sys
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import prosim_scene
import pytest
from prosim_scene import SceneError
from waiting import PATIENCE

SCENE = """LIGHTS POINT position 0 5 5
VIEW OBS 0 0 9 VRP 0 0 0
CSG-TREE + CUBE 0 SPHERE 1
SURFACE 0 material lambertiano
SURFACE 1 kd = 0.2 0.3 0.4
TRANSFORM 0
TRANSFORM 1 SCALE ({} 1 1) TRANSLATE (6 0 0)
END
"""


@pytest.fixture
def scene(write_scene):
    """A scene file, alone in its folder."""
    return write_scene(SCENE.format(1))


def everything(folder):
    """All files below a folder and their bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def named(xml):
    """The meshes that an XML file names, which have to exist."""
    names = re.findall(r'value="(s-meshes/[^"]*\.ply)"', xml.read_text())
    assert names and all((xml.parent / name).is_file() for name in names)
    return names


def test_files_of_the_users_in_the_folder_of_meshes_are_kept(scene):
    meshes = scene.parent / "s-meshes"
    meshes.mkdir()
    mine = {"madeira.png": b"\x89PNG\r\n\x1a\n", "surface_0.ply": b"mine", "notes.txt": b""}
    mine["surface_0-0123456789abcdef.ply"] = b"mine too"
    for name, content in mine.items():
        (meshes / name).write_bytes(content)
    (meshes / "surface_0-0123456789abcde0.ply").mkdir()
    scene.write_text(SCENE.format(1).replace("CUBE 0", "CUBE 0 s-meshes/madeira.png"))
    for width in (1, 2):
        prosim_scene.translate(scene, tolerance=1)
        scene.write_text(SCENE.format(width))
    assert {name: (meshes / name).read_bytes() for name in mine} == mine
    assert (meshes / "surface_0-0123456789abcde0.ply").is_dir()


def test_meshes_of_earlier_translations_are_removed_and_no_others(scene):
    first = named(prosim_scene.translate(scene, tolerance=1))
    scene.write_text(SCENE.format(2))
    second = named(prosim_scene.translate(scene, tolerance=1))
    assert len(set(first) - set(second)) == 1  # the ball; the cube is the same
    assert sorted(everything(scene.parent)) == sorted(["s.scn", "s.xml", *second])
    (scene.parent / second[0]).write_bytes(b"broken")
    named(prosim_scene.translate(scene, tolerance=1))
    assert len((scene.parent / second[0]).read_bytes()) > 6


NOT_REPLACED = "the meshes would replace this"
#: What is in the way of the translation of s.scn: its name, how the users made it, and the message.
OBSTACLES = {
    "file": ("s-meshes", Path.touch, NOT_REPLACED),
    "link": ("s-meshes", lambda path: path.symlink_to("."), NOT_REPLACED),
    "link to nowhere": ("s-meshes", lambda path: path.symlink_to("nowhere"), NOT_REPLACED),
    "text": ("s.xml", Path.touch, "is not a translation; move it"),
    "folder": ("s.xml", Path.mkdir, "the translation would replace this folder"),
    "the scene": ("s.xml", lambda path: path.with_suffix(".scn").rename(path), "is not a translation"),
}


@pytest.mark.parametrize("obstacle", OBSTACLES)
def test_a_file_of_the_users_in_the_way_is_an_error(scene, obstacle):
    name, make, message = OBSTACLES[obstacle]
    make(scene.with_name(name))
    before = everything(scene.parent)
    with pytest.raises(SceneError, match=message):
        prosim_scene.translate(scene if scene.exists() else scene.with_suffix(".xml"), tolerance=1)
    assert everything(scene.parent) == before


@pytest.fixture
def failing(monkeypatch):
    """Lets a function of ``os``, or a method of Path, fail with an error where a condition holds for its arguments."""

    def fail(name, number, condition, owner=os):
        real = getattr(owner, name)

        def function(*arguments, **keywords):
            if condition(*arguments):
                raise OSError(number, os.strerror(number), str(arguments[0]))
            return real(*arguments, **keywords)

        monkeypatch.setattr(owner, name, function)

    return fail


KILLED = """
import os, sys, prosim_scene
replace, countdown = os.replace, [int(sys.argv[2])]
def die(*arguments):
    countdown[0] -= 1
    if countdown[0] < 0:
        os._exit(9)
    replace(*arguments)
os.replace = die
prosim_scene.translate(sys.argv[1], tolerance=1)
"""


@pytest.mark.slow
@pytest.mark.parametrize("after", range(4))
def test_killed_at_any_step_the_xml_keeps_its_meshes(scene, after):
    xml = prosim_scene.translate(scene, tolerance=1)
    before = everything(scene.parent)
    scene.write_text(SCENE.format(2).replace("TRANSFORM 0", "TRANSFORM 0 TRANSLATE (0 .5 0)"))
    command = [sys.executable, "-W", "ignore", "-c", KILLED, scene, str(after)]
    ended = subprocess.run(command, check=False, timeout=PATIENCE).returncode
    assert ended == (9 if after < 3 else 0)  # two meshes, the XML
    if after < 3:
        now = everything(scene.parent)
        assert all(now[name] == before[name] for name in [*named(xml), "s.xml"])
    named(prosim_scene.translate(scene, tolerance=1))
    assert sorted(everything(scene.parent)) == sorted(["s.scn", "s.xml", *named(xml)])


def test_a_full_disk_is_a_scene_error_and_leaves_nothing(scene, failing):
    before = everything(scene.parent)
    failing("replace", errno.ENOSPC, lambda _, target: str(target).endswith(".xml"))
    with pytest.raises(SceneError, match="No space left on device"):
        prosim_scene.translate(scene, tolerance=1)
    with pytest.raises(SceneError, match="No space left on device"):
        prosim_scene.translate(scene, scene.parent / "new" / "deep", tolerance=1)
    assert everything(scene.parent) == before and os.listdir(scene.parent) == ["s.scn"]


@pytest.mark.parametrize("owner, function", [(Path, "write_bytes"), (os, "replace")])
def test_a_full_disk_leaves_a_rewritten_file_as_it_was(scene, failing, owner, function):
    failing(function, errno.ENOSPC, lambda *_: True, owner)
    with pytest.raises(SceneError, match=r"s.scn: No space left on device; the file is unchanged"):
        prosim_scene.rewrite(scene, "END\n")
    assert scene.read_text() == SCENE.format(1) and os.listdir(scene.parent) == ["s.scn"]


def test_the_folder_of_meshes_may_be_on_another_disk(scene, failing):
    """No file is renamed from there to another folder or back."""
    (meshes := scene.parent / "s-meshes").mkdir()
    failing("replace", errno.EXDEV, lambda source, target: Path(source).parent != Path(target).parent)
    xml = prosim_scene.translate(scene, tolerance=1)
    assert {Path(name).name for name in named(xml)} == set(os.listdir(meshes))
    assert sorted(os.listdir(scene.parent)) == ["s-meshes", "s.scn", "s.xml"]


@pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked there")
@pytest.mark.parametrize("fails", [False, True])
def test_meshes_are_removed_only_if_no_other_translation_writes(scene, failing, fails):
    """Its XML does not refer to its meshes yet."""
    import fcntl

    first = named(prosim_scene.translate(scene, tolerance=1))
    scene.write_text(SCENE.format(2))
    lock = os.open(scene.parent, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_SH)
    try:
        if fails:
            failing("replace", errno.ENOSPC, lambda _, target: str(target).endswith(".xml"))
            with pytest.raises(SceneError, match="No space left"):
                prosim_scene.translate(scene, tolerance=1)
        else:
            prosim_scene.translate(scene, tolerance=1)
        assert len([name for name in everything(scene.parent) if name.endswith(".ply")]) == 3
    finally:
        os.close(lock)
    if not fails:
        now = named(prosim_scene.translate(scene, tolerance=1))
        assert len(set(first) - set(now)) == 1
        assert sorted(everything(scene.parent)) == sorted(["s.scn", "s.xml", *now])


def test_a_folder_that_may_not_be_read_is_not_locked(scene, failing):
    failing("open", errno.EACCES, lambda path, *_: path == scene.parent)
    named(prosim_scene.translate(scene, tolerance=1))


@pytest.mark.slow
def test_the_meshes_of_a_loaded_scene_live_as_long_as_its_dictionary(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    loaded = prosim_scene.load(scene, tolerance=1)
    (folder,) = tmp_path.glob("prosim-scene-*")
    kept = {"type": "scene", "mine": copy.deepcopy(loaded["surface_1"])}
    del loaded
    gc.collect()
    assert Path(kept["mine"]["filename"]).is_file()
    del kept
    gc.collect()
    assert not folder.exists()


@pytest.mark.parametrize(
    "option, values",
    [
        ("tolerance", [0, float("nan"), "x"]),
        ("resolution", [5, (0, 1), (65536, 65536), ("a", "b"), (8, float("inf")), (8.0, 6), (8, 6, 3)]),
        ("samples", [0, 1001, "many", float("nan"), [3]]),
        ("target", ["pov", ["prosim"]]),
        ("light_units", ["lumen", {}]),
    ],
)
def test_a_wrong_option_is_a_scene_error(scene, option, values):
    for value in values:
        for function in (prosim_scene.translate, prosim_scene.load, prosim_scene.check):
            with pytest.raises(SceneError, match=re.escape(f"{option} is {value!r}; expected ")):
                function(scene, **{option: value})


# ---- What a translation leaves to the next one


CACHED = """DEFAULT $turn = 0
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


# what is told to the second and third translation, and how many trees are evaluated in all
@pytest.mark.slow
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
    path, cache = write_scene(CACHED), prosim_scene.TranslationCache()
    for define in {}, second, third:
        prosim_scene.translate(prosim_scene.document(path, define), tmp_path / "kept", cache=cache)
        prosim_scene.translate(path, tmp_path / "anew", define=define)
        assert everything(tmp_path / "kept") == everything(tmp_path / "anew")
    assert cache.evaluations == made


@pytest.mark.parametrize(
    "options",
    [
        {"resolution": (np.int64(8), np.int64(6)), "samples": np.int64(200)},
        {"resolution": np.array([8, 6], np.uint8), "samples": np.uint8(200)},
        {"resolution": [8, 6], "samples": 200, "tolerance": Fraction(1, 10)},
    ],
)
def test_numbers_of_all_types_are_options(scene, options):
    expected = prosim_scene.translate(scene, resolution=(8, 6), samples=200).read_text()
    assert prosim_scene.translate(scene, **options).read_text() == expected
    sampler = prosim_scene.load(scene, **options)["view"]["sampler"]
    assert repr(sampler["sample_count"]) == "40000"


@pytest.mark.filterwarnings("ignore::prosim_scene.SceneWarning")
@pytest.mark.parametrize("options", [{"resolution": (20, 10), "samples": 7}, {"target": "stock"}])
def test_another_view_needs_no_translation(write_scene, options):
    """Also where the eye is so near to a face that it would be cut off."""
    cube, cache = CACHED.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "CUBE 0"), prosim_scene.TranslationCache()
    path = write_scene(cube)
    prosim_scene.translate(path, cache=cache, **options)
    path.write_text(cube.replace("WINDOW -4 -4 4 4", "WINDOW -4 -3 4 4").replace("15 *", "1.0001 *"))
    document = prosim_scene.document(path, {"turn": 90})
    view = prosim_scene.load(document, cache=cache, **options)["view"]
    np.testing.assert_equal(view, prosim_scene.load(document, **options)["view"])
    assert view["near_clip"] < 1e-6 and cache.evaluations == 1
    path.write_text(cube.replace("-4 -4 4 4", "-4 4 4 4"))
    with pytest.raises(prosim_scene.SceneError, match="this window is empty"):
        prosim_scene.load(path, cache=cache, **options)


def test_cached_translation_repeats_the_warning_of_vanished_primitives(tmp_path, write_scene):
    cache = prosim_scene.TranslationCache()
    vanishing = CACHED.replace("- + CUBE 0 t-tijolo SPHERE 1 CYLINDER 2", "+ CUBE 0 + SPHERE 1 SPHERE 2")
    path = write_scene(vanishing.replace("SCALE (.4 .4 9) TRANSLATE (0 0 -4)", "SCALE (.4 .4 .4)"))
    for turn in (0, 20):
        with pytest.warns(prosim_scene.SceneWarning, match="nothing is visible of SPHERE 2"):
            prosim_scene.translate(path, tmp_path / "kept", define={"turn": turn}, cache=cache)
    assert cache.evaluations == 1
